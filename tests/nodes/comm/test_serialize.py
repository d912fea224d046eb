"""Message objects to bytes: what rclpy reads back, and nothing of the memory around them."""

import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ptnsbc_io.cdr import encode
from ptnsbc_nodes.comm.diagnostics import DiagnosticLevel, diagnostics, readiness


def status(name: str) -> DiagnosticStatus:
    pairs = [KeyValue(key="k" * n, value="µ" * n) for n in range(4)]
    return DiagnosticStatus(level=b"\x02", name=name, message="", values=pairs)


def marker(number: int) -> Marker:
    points = [Point(x=1.0 * n, y=2.0, z=3.0) for n in range(number)]
    colours = [ColorRGBA(r=0.5, a=1.0)] * number
    return Marker(ns="n" * number, id=-number, points=points, colors=colours, frame_locked=True)


MESSAGES = [
    DiagnosticArray(),
    DiagnosticArray(status=[status("a"), status("bcd")]),
    MarkerArray(markers=[marker(n) for n in range(4)]),
    TransformStamped(child_frame_id="uav1/base_link"),
    Odometry(child_frame_id="odd"),
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: type(message).__name__)
def test_rclpy_reads_back_what_was_written(message):
    assert deserialize_message(encode(message), type(message)) == message


def test_gaps_are_zero():
    message = DiagnosticArray(status=[DiagnosticStatus(name="a")])
    # header (stamp, empty frame id), gap, count, level, gap, length and text of the name
    assert encode(message)[12:32].hex(" ", 4) == "01000000 00000000 01000000 00000000 02000000"


@pytest.mark.parametrize("count", range(4))
def test_a_status_has_the_bytes_of_its_object(count):
    values = {"k" * n: "µ" * n for n in range(count)}
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    about = {"name": "uav3: planner", "message": "held", "hardware_id": "uav3", "values": pairs}
    array = DiagnosticArray(status=[DiagnosticStatus(level=b"\x02", **about)])
    array.header.stamp.sec, array.header.stamp.nanosec = 7, 8
    encoded = diagnostics(7_000_000_008, "uav3: planner", DiagnosticLevel.ERROR, "held", values)
    assert encoded == encode(array)


def test_diagnostics_message():
    data = diagnostics(
        1_500_000_000, "uav3: planner", DiagnosticLevel.WARN, "holding", readiness(["/a", "/b"])
    )
    message = deserialize_message(data, DiagnosticArray)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 500_000_000)
    (only,) = message.status
    assert (only.name, only.hardware_id, only.level) == ("uav3: planner", "uav3", b"\x01")
    assert {pair.key: pair.value for pair in only.values} == {
        "ready": "false",
        "waiting_for": "/a, /b",
    }
