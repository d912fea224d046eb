"""The counters that the verdict takes from /diagnostics."""

import pytest

from ptnsbc_io.wire import Diagnostics, DiagnosticStatus
from ptnsbc_tools.reading.diagnostics import DiagnosticCounters
from ptnsbc_tools.reading.disk_track import SampleFile


def array_of(name: str, value: str) -> Diagnostics:
    return Diagnostics(0, (DiagnosticStatus(name, 0, "", {"states_sent": value}),))


def test_counts_are_read_from_the_diagnostics_of_bridges() -> None:
    stamp = 1_795_289_342_123_456_789  # does not fit a float
    statuses = [
        array_of("bridge2: link", f"{stamp} 7"),
        array_of("bridge2: link", f"{stamp} 7"),  # nothing new since
        array_of("bridge2: link", f"{stamp + 20_000_000} 8"),
        array_of("bridge3: link", "0 0"),  # nothing sent yet
        array_of("bridge4: link", "rubbish"),
        array_of("uav1: planner", f"{stamp} 9"),
    ]
    counted = DiagnosticCounters(SampleFile())
    for array in statuses:
        counted.add(array)
    found = counted.sent()
    assert list(found) == [2]
    (block,) = found[2].blocks()
    assert block.t_ns.tolist() == [stamp, stamp + 20_000_000]
    assert block.values.tolist() == [[7.0], [8.0]]


@pytest.mark.parametrize(
    "sent",
    ["9" * 5000 + " 1", "1 " + "9" * 5000, f"{2**63} 1", f"0 {2**80}", "١ 1", "inf inf", " "],
)
def test_numbers_that_no_bridge_sends_count_as_none(sent: str) -> None:
    counted = DiagnosticCounters(SampleFile())
    counted.add(array_of("bridge2: link", sent))
    counted.add(array_of(f"bridge{'2' * 5000}: link", "1 1"))
    assert counted.sent() == {}


def test_a_counter_that_is_no_number_counts_as_zero() -> None:
    counted = DiagnosticCounters(SampleFile())
    values = {"missed_ticks": "inf", "ticks": "nan", "holding_s": "1e999", "saturated_s": "2.5"}
    counted.add(Diagnostics(0, (DiagnosticStatus("uav1: planner", 0, "", values),)))
    counted.add(Diagnostics(0, (DiagnosticStatus(f"uav{'1' * 5000}: planner", 0, "", values),)))
    (block,) = counted.counters()[1].blocks()
    assert block.values.sum() == 2.5
