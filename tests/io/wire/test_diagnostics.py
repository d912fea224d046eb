"""Our reader of /diagnostics against the messages that the nodes write."""

import pytest

from ptnsbc_io.wire import WireError, decode_diagnostics


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
