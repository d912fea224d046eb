"""The counters that the verdict takes from /diagnostics."""

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
