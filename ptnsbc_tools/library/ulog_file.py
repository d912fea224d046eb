"""Flights as ULog files, for PlotJuggler and the tools of PX4; needs pyulog (`pip install "ptnsbc[ulog]"`).

Topics, fields, units and frames are those of PX4's messages: world NED, body FRD, quaternions w x y z,
microseconds. `formation_error` is ours. Instance k of a topic is the k-th UAV of the scenario, from 0.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from ptnsbc_core.types import Array
from ptnsbc_io.mavlink.frames import (
    quaternion_enu_flu_to_ned_frd,
    vector_enu_to_ned,
    vector_flu_to_frd,
)
from ptnsbc_sim.verdict.formation_error import formation_vectors
from ptnsbc_tools.files import replacing
from ptnsbc_tools.library.flight import Flight
from ptnsbc_tools.library.optional import required

_FORMATS = {
    "vehicle_local_position": "float x;float y;float z;float vx;float vy;float vz;",
    "vehicle_local_position_groundtruth": "float x;float y;float z;",
    "vehicle_local_position_setpoint": "float x;float y;float z;",
    "vehicle_attitude": "float[4] q;",
    "vehicle_angular_velocity": "float[3] xyz;",
    "formation_error": "float error_m;",
}
_INFO = ord("6")  # level of a logged text
_TYPES = {"uint64_t": "<u8", "float": "<f4"}


def write_ulog(flight: Flight, path: Path) -> None:
    """Write the topics of every UAV of a flight into FILE.ulg.

    Raises:
        LibraryMissingError: pyulog is not installed.
        OutputFileError: the file cannot be written.
    """
    ULog = required("pyulog", "export to .ulg", "ulog").ULog
    log = ULog(None)
    for name, fields in _FORMATS.items():
        text = f"{name}:uint64_t timestamp;{fields}"
        log.message_formats[name] = ULog.MessageFormat(text.encode(), None)
    instances = ", ".join(f"{row} uav{uav}" for row, uav in enumerate(flight.uavs))
    said = f"{flight.scenario.name}: instances {instances}".encode()
    log.logged_messages.append(ULog.MessageLogging(struct.pack("<BQ", _INFO, 0) + said, None))
    away = _away(flight)
    for row, uav in enumerate(flight.uavs):
        for name, values in _topics(flight, row, away[uav]):
            log.data_list.append(ULog.Data(_logged(log, name, row, flight.time_s, values)))
    with replacing(path) as part:
        path.parent.mkdir(parents=True, exist_ok=True)
        log.write_ulog(str(part))


def _away(flight: Flight) -> dict[int, Array]:
    """Position beside the place (T, 3) [m], ENU, of every UAV."""
    positions = {uav: flight.position_m[:, row] for row, uav in enumerate(flight.uavs)}
    return formation_vectors(flight.recording, flight.recording.grid(), positions)


def _topics(flight: Flight, row: int, away: Array) -> Iterator[tuple[str, Array]]:
    """Name and columns (k, T) of every topic of a UAV."""
    recording, true = flight.recording, flight.position_m[:, row]
    measured = recording.odometry[flight.uavs[row]].at(recording.grid(), 3)
    velocity = vector_enu_to_ned(flight.velocity_m_s[:, row].T)
    yield "vehicle_local_position", np.vstack([vector_enu_to_ned(measured.T), velocity])
    if recording.judged_by == "truth":
        yield "vehicle_local_position_groundtruth", vector_enu_to_ned(true.T)
    yield "vehicle_local_position_setpoint", vector_enu_to_ned((true - away).T)
    attitudes = [quaternion_enu_flu_to_ned_frd(one) for one in flight.quaternion[:, row]]
    yield "vehicle_attitude", np.array(attitudes).T
    yield "vehicle_angular_velocity", vector_flu_to_frd(flight.rate_rad_s[:, row].T)
    yield "formation_error", flight.error_m[np.newaxis, :, row]


def _logged(log: Any, name: str, row: int, time_s: Array, columns: Array) -> SimpleNamespace:
    """A topic of a UAV as pyulog has it after it has read one: description, and all messages as bytes."""
    described = [("timestamp", "uint64_t")]
    for kind, size, field in log.message_formats[name].fields[1:]:
        fields = [f"{field}[{part}]" for part in range(size)] if size else [field]
        described.extend((one, kind) for one in fields)
    messages = np.empty(time_s.size, [(field, _TYPES[kind]) for field, kind in described])
    for (field, _), values in zip(described, [np.rint(time_s * 1e6), *columns], strict=True):
        messages[field] = values
    return SimpleNamespace(
        multi_id=row,
        msg_id=len(log.data_list),
        message_name=name,
        field_data=[SimpleNamespace(field_name=field, type_str=kind) for field, kind in described],
        timestamp_idx=0,
        dtype=messages.dtype,
        buffer=messages.tobytes(),
    )
