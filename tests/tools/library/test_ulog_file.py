"""ULog files: read back by pyulog and, byte by byte, by the definition of the format."""

from __future__ import annotations

import re
import struct
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ptnsbc_io.mavlink.frames import quaternion_enu_flu_to_ned_frd
from ptnsbc_sim.verdict import Recording
from ptnsbc_tools.library.export import ExportError, export
from ptnsbc_tools.library.flight import Flight, flight_in
from ptnsbc_tools.library.optional import LibraryMissingError
from ptnsbc_tools.library.sweeping import Sweep
from ptnsbc_tools.library.ulog_file import write_ulog

SAMPLE = Path("bags/sample")


def test_without_the_library_the_way_out_is_named(
    fly: Callable[..., Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(LibraryMissingError, match=r'pyulog is not installed: .*"ptnsbc\[ulog\]"'):
        write_ulog(Flight(fly(seconds=1.0)), tmp_path / "flight.ulg")
    assert not list(tmp_path.iterdir())


def test_a_sweep_is_no_ulog(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"a sweep: expected \.csv or \.parquet"):
        export(Sweep.__new__(Sweep), tmp_path / "sweep.ulg")


def test_every_uav_is_an_instance_of_the_topics_of_px4(tmp_path: Path) -> None:
    """Position and velocity NED, attitude w x y z of FRD in NED, rates FRD, microseconds after the epoch."""
    pyulog = pytest.importorskip("pyulog")
    flight = flight_in(SAMPLE)
    export(flight, tmp_path / "sample.ulg")
    log = pyulog.ULog(str(tmp_path / "sample.ulg"))
    assert not log.file_corruption
    instances = ", ".join(f"{row} uav{uav}" for row, uav in enumerate(flight.uavs))
    assert [one.message for one in log.logged_messages] == [
        f"{flight.scenario.name}: instances {instances}"
    ]
    for row in range(len(flight.uavs)):
        read = {one.name: one.data for one in log.data_list if one.multi_id == row}
        odometry = flight.recording.odometry[flight.uavs[row]].at(flight.recording.grid())
        body = read["vehicle_local_position"]
        np.testing.assert_array_equal(body["timestamp"], np.rint(flight.time_s * 1e6))
        _equal([body["x"], body["y"], -body["z"]], odometry[:, [1, 0, 2]])
        _equal([body["vy"], body["vx"], -body["vz"]], flight.velocity_m_s[:, row])
        place = read["vehicle_local_position_setpoint"]
        _equal([read["formation_error"]["error_m"]], flight.error_m[:, row, np.newaxis])
        away = [body[axis].astype(float) - place[axis] for axis in "xyz"]
        np.testing.assert_allclose(np.linalg.norm(away, axis=0), flight.error_m[:, row], atol=2e-6)
        rates = [read["vehicle_angular_velocity"][f"xyz[{axis}]"] for axis in range(3)]
        _equal([rates[0], -rates[1], -rates[2]], flight.rate_rad_s[:, row])
        attitude = [read["vehicle_attitude"][f"q[{part}]"][-1] for part in range(4)]
        expected = quaternion_enu_flu_to_ned_frd(flight.quaternion[-1, row])
        np.testing.assert_allclose(attitude, expected, atol=1e-7)


def test_the_bytes_are_those_of_the_format(fly: Callable[..., Recording], tmp_path: Path) -> None:
    """docs.px4.io, "ULog File Format": header, flags first, formats and subscriptions before data."""
    pytest.importorskip("pyulog")
    recording = fly(seconds=1.0)
    flight = Flight(replace(recording, truth=recording.odometry))
    write_ulog(flight, tmp_path / "flight.ulg")
    data = (tmp_path / "flight.ulg").read_bytes()
    assert data[:7] == b"ULog\x01\x12\x35"
    found = list(_messages(data[16:]))
    kinds = "".join(kind for kind, _ in found)
    assert re.fullmatch("BF+A+[LD]+", kinds)
    formats = dict(body.decode().split(":", 1) for kind, body in found if kind == "F")
    assert formats["vehicle_local_position"].startswith("uint64_t timestamp;float x;float y;")
    topics = [body for kind, body in found if kind == "A"]  # instance, number (2 bytes), name
    name = b"vehicle_local_position_groundtruth"
    number = next(body[1:3] for body in topics if body[0] == 1 and body[3:] == name)
    rows = [body[2:] for kind, body in found if kind == "D" and body[:2] == number]
    t_us, north, east, down = struct.unpack_from("<Qfff", rows[50])
    assert t_us == round(flight.time_s[50] * 1e6)
    np.testing.assert_allclose([east, north, -down], flight.position_m[50, 1], rtol=1e-7)


def _equal(columns: list[np.ndarray], expected: np.ndarray) -> None:
    np.testing.assert_array_equal(np.stack(columns, axis=1), expected.astype(np.float32))


def _messages(data: bytes) -> Iterator[tuple[str, bytes]]:
    at = 0
    while at < len(data):
        size, kind = struct.unpack_from("<Hc", data, at)
        yield kind.decode(), data[at + 3 : at + 3 + size]
        at += 3 + size
