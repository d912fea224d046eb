"""What the pre-flight check says of faults."""

import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.check import check


def said_of(**fault):
    scenario = load_scenario("paper_5", {"faults": [{"at_s": 1, **fault}]})
    found = [one for one in check(scenario) if one.key.startswith("faults[0]")]
    return [(one.severity, one.advice) for one in found]


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"kind": "silence", "uav": 2}, []),
        ({"kind": "kill", "process": "uav2"}, []),
        ({"kind": "kill", "process": "sim"}, [("info", "only in real time")]),
        ({"kind": "disk_full"}, [("info", "only in real time")]),
        ({"kind": "freeze", "uav": 2, "duration_s": 1}, [("info", "only in real time")]),
    ],
)
def test_where_a_fault_is_injected(fault, said):
    assert said_of(**fault) == said


def test_a_fault_after_the_flight_is_a_warning():
    assert said_of(kind="silence", uav=2, at_s=1e6)[0][0] == "warning"
