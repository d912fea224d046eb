"""The decision on the slots as bytes: what comes back, and what is dropped and named."""

import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.wire import HeaderTemplate
from ptnsbc_nodes.comm.announcements import (
    DecidedSlots,
    Decision,
    decode_slots,
    encode_slots,
    keep_recorded,
)
from ptnsbc_sim.scenario import load_scenario

SCENARIO = load_scenario("paper_5", {"formation.assignment": "optimal"})
SLOTS = {1: 3, 2: 5, 3: 4, 4: 1, 5: 2}
T0_NS = 1_700_000_000_000_000_123


def test_slots_come_back_with_their_epoch() -> None:
    data = encode_slots(Decision(T0_NS, SLOTS))
    assert decode_slots(data, SCENARIO) == Decision(T0_NS, SLOTS)
    decided = DecidedSlots(SCENARIO)
    assert decided.of(T0_NS) is None
    for _ in range(2):  # a latched topic repeats
        decided.keep(decided.decode(data))
    assert (decided.of(T0_NS), decided.of(T0_NS + 1)) == (SLOTS, None)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "slots of 0 UAVs"),
        ("1:1 2:2 3:3 4:4", "look at UAV 5"),
        ("1:1 2:2 3:3 4:4 5:5 6:6", "look at UAV 6"),
        ("1:1 2:2 3:3 4:4 5:4", "no UAV or more than one takes slot 5"),
        ("1:1 2:2 3:3 4:4 5:9", "takes slot 5, 9"),
        ("1:1 2:2 3:3 4:4 5:5 5:5", "each UAV once"),
        ("1:1 2:2 3:3 4:4 5:-5", "expected a pair UAV:SLOT"),
        ("1:1 2:2 3:3 4:4 5", "expected a pair UAV:SLOT"),
        ("form", "expected a pair UAV:SLOT"),
        ("1:" + "9" * 5000, "expected a pair UAV:SLOT"),
        ("\u0661:\u0661", "expected a pair UAV:SLOT"),
    ],
)
def test_what_is_no_decision_is_refused_and_named(text: str, reason: str) -> None:
    decided = DecidedSlots(SCENARIO)
    data = HeaderTemplate(text).encode(T0_NS)
    with pytest.raises(PtnsbcError, match=reason):
        decided.decode(data)
    keep_recorded(decided, data)
    assert decided.of(T0_NS) is None


@pytest.mark.parametrize("size", range(0, 40, 5))
def test_bytes_that_are_cut_are_refused(size: int) -> None:
    with pytest.raises(PtnsbcError):
        DecidedSlots(SCENARIO).decode(encode_slots(Decision(T0_NS, SLOTS))[:size])


def test_the_first_decision_for_an_epoch_counts() -> None:
    decided = DecidedSlots(SCENARIO)
    decided.keep(Decision(T0_NS, SLOTS))
    other = encode_slots(Decision(T0_NS, {uav: uav for uav in SLOTS}))
    with pytest.raises(PtnsbcError, match="second slots of the epoch"):
        decided.decode(other)
    keep_recorded(decided, other)
    assert decided.of(T0_NS) == SLOTS


def test_no_more_decisions_than_legs_are_remembered() -> None:
    decided = DecidedSlots(SCENARIO)
    for number in range(1000):
        decided.keep(Decision(number, SLOTS))
    kept = [number for number in range(1000) if decided.of(number)]
    assert kept == list(range(1000 - len(kept), 1000))
    assert len(kept) < 500
