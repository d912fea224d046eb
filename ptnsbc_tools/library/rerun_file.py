"""Flights as recordings of the viewer Rerun; needs its library (`pip install "ptnsbc[rerun]"`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ptnsbc_sim.scenario.obstacles import Obstacle
from ptnsbc_tools.files import replacing
from ptnsbc_tools.library.flight import Flight
from ptnsbc_tools.library.optional import required
from ptnsbc_tools.plotting.chart import COLOURS, look

TIMELINE = "flight"
"""Name of the time line: seconds after the epoch."""

_WITHOUT_END_M = 40.0


def write_rerun(flight: Flight, path: Path) -> None:
    """Write the bodies, paths, errors and obstacles of a flight into FILE.rrd.

    Raises:
        LibraryMissingError: rerun-sdk is not installed.
        OutputFileError: the file cannot be written.
    """
    rerun = required("rerun", "export to .rrd", "rerun")
    with replacing(path) as part:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = rerun.RecordingStream("ptnsbc", recording_id=flight.scenario.name)
        stream.save(part)
        stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for one in flight.scenario.obstacles:
            _obstacle(rerun, stream, flight, one)
        for row, uav in enumerate(flight.uavs):
            _uav(rerun, stream, flight, row, uav)
        stream.flush()
        stream.disconnect()


def _uav(rerun: Any, stream: Any, flight: Flight, row: int, uav: int) -> None:
    times = rerun.TimeColumn(TIMELINE, duration=flight.time_s)
    shade = [list(bytes.fromhex(COLOURS[look(row).colour][1:]))]
    places = flight.position_m[:, row]
    name = f"world/uav{uav}"
    stream.log(f"{name}/path", rerun.LineStrips3D([places], colors=shade), static=True)
    style = rerun.Points3D.from_fields(colors=shade, radii=[0.12], labels=[f"uav{uav}"])
    stream.log(f"{name}/body", style, static=True)
    moved = rerun.Points3D.columns(positions=places)
    stream.send_columns(f"{name}/body", indexes=[times], columns=moved)
    error = f"error_m/uav{uav}"
    stream.log(error, rerun.SeriesLines(colors=shade, names=[f"uav{uav}"]), static=True)
    values = rerun.Scalars.columns(scalars=flight.error_m[:, row])
    stream.send_columns(error, indexes=[times], columns=values)


def _obstacle(rerun: Any, stream: Any, flight: Flight, one: Obstacle) -> None:
    """A body as a ball of its keep-out, a cylinder or a box, at its place or on its way."""
    entity, drawn = f"world/obstacles/{one.name}", one.drawn(_WITHOUT_END_M)
    half = 0.5 * drawn.size
    if one.kind == "cylinder":
        body = rerun.Cylinders3D(lengths=[2.0 * half[2]], radii=[half[0]])
    else:
        shape = rerun.Ellipsoids3D if one.kind == "sphere" else rerun.Boxes3D
        body = shape(half_sizes=[half])
    stream.log(entity, body, static=True)
    turn = rerun.Quaternion(xyzw=drawn.quaternion)
    if one.path is None:
        stream.log(
            entity, rerun.Transform3D(translation=drawn.centre, quaternion=turn), static=True
        )
        return
    places = one.motion(flight.time_s).positions + (drawn.centre - one.position)
    moved = rerun.Transform3D.columns(translation=places, quaternion=[turn] * len(places))
    times = rerun.TimeColumn(TIMELINE, duration=flight.time_s)
    stream.send_columns(entity, indexes=[times], columns=moved)
