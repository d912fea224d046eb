"""Faults in a scenario file: what fits together, and what is said of what does not."""

import pytest

from ptnsbc_sim.scenario import ScenarioError, load_scenario
from ptnsbc_sim.scenario.mission.fault_rules import FAULTS, NEVER_NS, modelled

GOOD = {
    "silence": {"uav": 2},
    "loss": {"uav": 2, "share": 0.3},
    "delay": {"uav": 2, "delay_s": 0.1},
    "nan": {"uav": 2},
    "jump": {"uav": 2, "offset_m": [1, 0, 0]},
    "kill": {"process": "uav2"},
    "freeze": {"process": "sim", "duration_s": 1},
    "restart": {"uav": 2},
    "clock_offset": {"uav": 2, "offset_s": -0.4},
    "disk_full": {},
}


def with_fault(**keys):
    return load_scenario("paper_5", {"faults": [{"at_s": 1, **keys}]})


@pytest.mark.parametrize("kind", GOOD)
def test_every_kind_can_be_written(kind):
    (fault,) = with_fault(kind=kind, **GOOD[kind]).faults
    assert fault.rule is FAULTS[kind]
    assert kind in fault.text
    assert "at 1 s" in fault.text


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"kind": "silence"}, r"faults\[0\].uav: missing"),
        ({"kind": "silence", "uav": 9}, "no such UAV: expected one of the ids under uavs: 1, 2"),
        ({"kind": "silence", "process": "uav2"}, "process: uav2: silence strikes a UAV"),
        ({"kind": "kill"}, "kill needs uav or process"),
        ({"kind": "kill", "uav": 2, "process": "uav3"}, "kill needs uav or process"),
        ({"kind": "kill", "process": "bridge9"}, "9: no such UAV"),
        ({"kind": "kill", "uav": 2, "duration_s": 1}, "kill has no end"),
        ({"kind": "freeze", "uav": 2}, "duration_s: missing"),
        ({"kind": "loss", "uav": 2}, "share: missing: loss needs it"),
        ({"kind": "loss", "uav": 2, "share": 0.1, "delay_s": 1}, "delay_s: loss does not take it"),
        ({"kind": "disk_full", "uav": 2}, "strikes the recorder: expected no UAV"),
        ({"kind": "ghosts", "uav": 2}, r"faults\[0\].kind"),
        ({"kind": "battery", "uav": 2}, "expected one of: silence.*`ptnsbc autopilot --fault`"),
        ({"kind": "kill", "process": "launcher"}, r"faults\[0\].process"),
        ({"kind": "silence", "uav": 2, "at_s": -1}, r"faults\[0\].at_s"),
        ({"kind": "silence", "uav": 2, "for_s": 1}, "for_s.*unknown key"),
    ],
)
def test_what_does_not_fit_is_refused_in_words(keys, said):
    with pytest.raises(ScenarioError, match=said):
        with_fault(**keys)


def test_every_kind_is_known_here():
    assert set(FAULTS) == set(GOOD)


def test_units_may_be_repeated_and_times_count_from_the_epoch():
    (fault,) = with_fault(kind="silence", uav=2, at_s="2 s", duration_s="500 s").faults
    assert fault.window_ns(7) == (2_000_000_007, 502_000_000_007)
    (fault,) = with_fault(kind="silence", uav=2).faults
    assert fault.window_ns(0) == (1_000_000_000, NEVER_NS)


def test_a_scenario_may_have_an_empty_list():
    empty = load_scenario("paper_5", {"faults": []})
    assert empty.faults == () == modelled(empty.faults)
    assert not empty.imperfect


def test_only_what_a_headless_flight_injects_makes_it_imperfect():
    assert with_fault(kind="silence", uav=2).imperfect
    for fault in (
        {"kind": "freeze", "uav": 2, "duration_s": 1},
        {"kind": "kill", "process": "sim"},
    ):
        found = with_fault(**fault)
        assert modelled(found.faults) == ()
        assert not found.imperfect
