"""The decision on the slots, which one process makes and all others hear: /formation/slots.

A message belongs to the epoch of its stamp. Its text has a pair for each UAV, "1:1 2:5 3:2".
"""

from __future__ import annotations

import re
from contextlib import suppress
from typing import NamedTuple

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.wire import HeaderTemplate, decode_header
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.slots import Slots, SlotsError, require_slots

_PAIR = re.compile(r"[0-9]{1,3}:[0-9]{1,3}")
_MOST_DECISIONS = 256  # that are remembered


class Decision(NamedTuple):
    """The slot of every UAV from an epoch on."""

    t0_ns: int  # of the epoch
    slots: Slots


def encode_slots(decision: Decision) -> bytes:
    """std_msgs/Header of a decision."""
    text = " ".join(f"{uav}:{slot}" for uav, slot in decision.slots.items())
    return HeaderTemplate(text).encode(decision.t0_ns)


def decode_slots(data: bytes, scenario: Scenario) -> Decision:
    """The decision in a message.

    Raises:
        WireError: no std_msgs/Header.
        SlotsError: its text does not give every UAV of the scenario a slot of its own.
    """
    t0_ns, text = decode_header(data)
    slots: dict[int, int] = {}
    for pair in text.split():
        if not _PAIR.fullmatch(pair):
            raise SlotsError(f"slots {pair[:20]!r}: expected a pair UAV:SLOT")
        uav, slot = map(int, pair.split(":"))
        if uav in slots:
            raise SlotsError(f"slots {pair!r}: expected each UAV once")
        slots[uav] = slot
    require_slots(scenario, slots)
    return Decision(t0_ns, slots)


class DecidedSlots:
    """The decisions that have been heard, by epoch. The first one for an epoch counts."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._by_epoch: dict[int, Slots] = {}

    def decode(self, data: bytes) -> Decision:
        """As `decode_slots`; SlotsError also for a decision that contradicts the one for its epoch."""
        found = decode_slots(data, self._scenario)
        if self._by_epoch.get(found.t0_ns, found.slots) != found.slots:
            epoch_s = found.t0_ns * 1e-9
            raise SlotsError(f"second slots of the epoch at {epoch_s:.3f} s: the first ones count")
        return found

    def keep(self, decision: Decision) -> None:
        """Take a decision; one that the latched topic repeats changes nothing."""
        self._by_epoch.setdefault(decision.t0_ns, decision.slots)
        while len(self._by_epoch) > _MOST_DECISIONS:
            del self._by_epoch[next(iter(self._by_epoch))]

    def of(self, t0_ns: int) -> Slots | None:
        """The slots of an epoch [ns]; None while they have not been heard."""
        return self._by_epoch.get(t0_ns)


def keep_recorded(decided: DecidedSlots, data: bytes) -> None:
    """Take a recorded message as the UAVs did: one that is no decision is forgotten."""
    with suppress(PtnsbcError):
        decided.keep(decided.decode(data))
