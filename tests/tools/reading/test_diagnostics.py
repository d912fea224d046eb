"""Our reader of /diagnostics against the messages that the nodes write."""

import pytest

from ptnsbc_io.wire import WireError
from ptnsbc_tools.reading.diagnostics import (
    DiagnosticCounters,
    Diagnostics,
    DiagnosticStatus,
    decode_diagnostics,
)
from ptnsbc_tools.reading.disk_track import SampleFile


def test_what_a_node_writes_is_read() -> None:
    pytest.importorskip("rclpy")
    pytest.importorskip("diagnostic_msgs")
    from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics

    values = {"ready": "true", "ä": "", "saturated_s": "0.700"}
    data = diagnostics(1_500_000_000, "uav3: planner", DiagnosticLevel.WARN, "holding", values)
    found = decode_diagnostics(data)
    assert found.stamp_ns == 1_500_000_000
    assert found.statuses[0] == ("uav3: planner", 1, "holding", values)


def test_a_cut_message_is_an_error_in_words() -> None:
    pytest.importorskip("rclpy")
    from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics

    data = diagnostics(0, "uav3: planner", DiagnosticLevel.OK, "", {"ready": "true"})
    for size in range(4, len(data)):
        with pytest.raises(WireError):
            decode_diagnostics(data[:size])


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
