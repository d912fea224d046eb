"""A scenario file to begin with: a shape of so many UAVs, and every block with a comment."""

from __future__ import annotations

import json
import os
from pathlib import Path
from string import Template
from typing import NamedTuple

import numpy as np

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_core.types import HEADING_TABLE
from ptnsbc_io.files import replacing
from ptnsbc_sim import scenario
from ptnsbc_sim.scenario import scenario_from_text
from ptnsbc_sim.scenario.mission.shapes import SHAPES
from ptnsbc_sim.scenario.mission.trajectories import extremes, trajectory_of
from ptnsbc_sim.scenario.problems import similar
from ptnsbc_tools.library.crazyflies import lab_text
from ptnsbc_tools.limits import path_of, refuse_outside

SCHEMA = Path(scenario.__file__).with_name("scenario.schema.json")
"""The schema that the modeline of a scenario file names."""

MOST = 254
_RADIUS_M, _HEIGHT_M, _START_M = 5.0, 6.0, 1.0
_WIDEST = 0.4  # of the farthest place: the radius of the circle
_SPEED_M_S, _SLOWEST_M_S = 0.5, 0.1  # of the leader; of a path that has a heading
_DURATION_S, _SHORTEST_S = 50.0, 10.0
_BEFORE_ITS_END = 0.98  # of a file: after it the leader stays
_AWAY_M = 8.0  # of the places in comments
_WIDER, _LONGEST_WAY_M = 0.5, 4.0  # of the starts


class NewScenarioError(PtnsbcError):
    """A scenario that cannot be made."""


class _Way(NamedTuple):
    """The leader's trajectory."""

    block: str
    duration_s: float
    begin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m]
    yaw_rad: float = 0.0  # at its begin
    turns: bool = True  # it has a heading all along


def _way_in(file: Path, folder: Path) -> _Way:
    """The path of a file; its heading is that of the file, or that of the path where it never stands still."""
    keys = {"leader.trajectory": {"kind": "file", "file": str(file.resolve())}}
    path = scenario_from_text("extends: paper_5_free", keys, source=str(file)).leader.trajectory
    curve, named = trajectory_of(path), json.dumps(os.path.relpath(file, folder))
    block = f"kind: file, file: {named}"
    duration_s = max(_BEFORE_ITS_END * float(curve.table[-1, 0]), _SHORTEST_S)
    turns = curve.numbers[1] == HEADING_TABLE
    if not turns and extremes(path, duration_s).slowest_m_s > _SLOWEST_M_S:
        curve = trajectory_of(path.model_copy(update={"heading": "path"}))
        block, turns = f"{block}, heading: path", True
    begin = reference(curve, 0.0)
    return _Way(block, round(duration_s, 2), begin.position, begin.yaw, turns)


def text_of(
    name: str,
    shape: str = "v",
    n: int = 5,
    spacing_m: float = 2.0,
    trajectory: str | Path | None = None,
    folder: Path = Path(),
) -> str:
    """The file of a new scenario: it passes `ptnsbc check`, and every block has a comment; arguments as of `new`."""
    if shape not in SHAPES:
        raise NewScenarioError(f"shape {shape}: {similar(shape, SHAPES)}")
    refuse_outside("n", n, 2, MOST)
    refuse_outside("spacing_m", spacing_m, 1.0, 100.0)
    places = SHAPES[shape](n, spacing_m)
    farthest_m, lowest_m = float(np.linalg.norm(places, axis=1).max()), float(places[:, 2].min())
    if trajectory is None:
        z = max(_HEIGHT_M, 2.0 * _START_M - lowest_m)  # no place in the ground
        radius_m = max(_RADIUS_M, _WIDEST * farthest_m)  # the outermost UAV can follow its turn
        block = f"kind: circle, centre_m: [0, 0, {z:g}], radius_m: {radius_m:g}, "
        block += f"rate_rad_s: {_SPEED_M_S / radius_m:.2g}, heading: path"
        way = _Way(block, _DURATION_S, (0.0, radius_m, z))
    else:
        way = _way_in(Path(trajectory), folder)
    x, y, z = way.begin
    # Farther apart than the places: the formation is seen to form, and nobody crosses another's way.
    wide = places * (1.0 + min(_WIDER, _LONGEST_WAY_M / farthest_m))
    cos, sin = np.cos(way.yaw_rad), np.sin(way.yaw_rad)
    turned = wide @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    starts = np.round(turned + np.array([x, y, _START_M - float(wide[:, 2].min())]), 2) + 0.0
    template = Template(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
    return template.substitute(
        # From the folder of the file, so that a clone of it finds the schema too.
        schema=os.path.relpath(SCHEMA, folder),
        name=name,
        shape=shape,
        n=n,
        spacing=f"{spacing_m:g}",
        links=", ".join(str(uav) for uav in range(2, n + 1)),
        edges=", ".join(f"[{uav}, {uav + 1}]" for uav in range(2, n)),
        duration=f"{way.duration_s:g}",
        trajectory=f"{{{way.block}}}",
        begin=f"[{x:g}, {y:g}, {z:g}]",
        ahead=f"[{x + _AWAY_M:g}, {y:g}, {z:g}]",
        house=f"[{x + _AWAY_M:g}, {y + _AWAY_M:g}, {0.5 * z:g}]",
        height=f"{z:g}",
        aside=f"[{x:g}, {y + _AWAY_M:g}, {z:g}]",
        frame="heading" if way.turns else "world",
        other_tasks=", ".join(task for task in TASKS if task != "relative_position"),
        starts="\n".join(
            f"  - {{id: {uav}, position_m: [{x:g}, {y:g}, {z:g}]}}"
            for uav, (x, y, z) in enumerate(starts.tolist(), 1)
        ),
    )


def new(
    file: str | Path,
    shape: str = "v",
    n: int = 5,
    spacing_m: float = 2.0,
    *,
    trajectory: str | Path | None = None,
    crazyflies: str | Path | None = None,
    overwrite: bool = False,
) -> Path:
    """Write a commented scenario of so many UAVs, as `ptnsbc new`, and return its file.

    Args:
        file: NAME, which becomes NAME.yaml, or the file.
        shape: v, line, column, grid, circle or sphere.
        n: UAVs with the leader.
        spacing_m: distance of neighbours.
        trajectory: file with the path of the leader, of any form that `kind: file` knows; by default a circle.
        crazyflies: crazyflies.yaml of Crazyswarm2: its robots fly what `crazyflie_4` does, whatever is given before.
        overwrite: replace an existing file.

    Raises:
        NewScenarioError: an unknown shape, or a file that exists.
        LimitError: a number or a distance out of range.
        ScenarioError: a trajectory that is none, or a crazyflies.yaml.
        OutputFileError: the file cannot be written.
    """
    given = path_of("file", file)
    if not given.name:
        raise NewScenarioError(f'"{file}": expected a name, or a file NAME.yaml')
    path = given if given.suffix in (".yaml", ".yml") else given.with_name(f"{given.name}.yaml")
    if path.exists() and not overwrite:
        raise NewScenarioError(f"{path}: exists: choose another name, or overwrite it")
    if crazyflies is None:
        text = text_of(named(path), shape, n, spacing_m, trajectory, path.parent)
    else:
        text = lab_text(Path(crazyflies), named(path))
    with replacing(path, folder=True) as part:
        part.write_text(text, encoding="utf-8")
    return path


def named(path: Path) -> str:
    """The name of a scenario in a file: the file's own, with what a name cannot have replaced."""
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in path.stem)
    return kept[:64] or "scenario"
