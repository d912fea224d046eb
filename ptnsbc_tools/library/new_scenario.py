"""A scenario file to begin with: a shape of so many UAVs, and every block with a comment."""

from __future__ import annotations

import os
from pathlib import Path
from string import Template

import numpy as np

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_io.files import replacing
from ptnsbc_sim import scenario
from ptnsbc_sim.scenario.mission.shapes import SHAPES
from ptnsbc_sim.scenario.problems import similar
from ptnsbc_tools.limits import refuse_outside

SCHEMA = Path(scenario.__file__).with_name("scenario.schema.json")
"""The schema that the modeline of a scenario file names."""

MOST = 254
_RADIUS_M, _HEIGHT_M, _START_M = 5.0, 6.0, 1.0
_WIDER, _LONGEST_WAY_M = 0.5, 4.0  # of the starts


class NewScenarioError(PtnsbcError):
    """A scenario that cannot be made."""


def text_of(
    name: str, shape: str = "v", n: int = 5, spacing_m: float = 2.0, folder: Path = Path()
) -> str:
    """The file of a new scenario: it passes `ptnsbc check`, and every block has a comment; arguments as of `new`."""
    if shape not in SHAPES:
        raise NewScenarioError(f"shape {shape}: {similar(shape, SHAPES)}")
    refuse_outside("n", n, 2, MOST)
    refuse_outside("spacing_m", spacing_m, 1.0, 100.0)
    places = SHAPES[shape](n, spacing_m)
    lowest = float(places[:, 2].min())
    height_m = _HEIGHT_M + max(-lowest - _HEIGHT_M + 2.0 * _START_M, 0.0)  # no place in the ground
    # Farther apart than the places: the formation is seen to form, and nobody crosses another's way.
    farthest_m = float(np.linalg.norm(places, axis=1).max())
    places = places * (1.0 + min(_WIDER, _LONGEST_WAY_M / farthest_m))
    lift_m = _START_M - float(places[:, 2].min())
    starts = np.round(places + np.array([0.0, _RADIUS_M, lift_m]), 2) + 0.0
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
        height=f"{height_m:g}",
        radius=f"{_RADIUS_M:g}",
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
    overwrite: bool = False,
) -> Path:
    """Write a commented scenario of so many UAVs, as `ptnsbc new`, and return its file.

    Args:
        file: NAME, which becomes NAME.yaml, or the file.
        shape: v, line, column, grid, circle or sphere.
        n: UAVs with the leader.
        spacing_m: distance of neighbours.
        overwrite: replace an existing file.

    Raises:
        NewScenarioError: an unknown shape, a number or a distance out of range, or a file that exists.
        OutputFileError: the file cannot be written.
    """
    given = Path(file)
    if not given.name:
        raise NewScenarioError(f'"{file}": expected a name, or a file NAME.yaml')
    path = given if given.suffix in (".yaml", ".yml") else given.with_name(f"{given.name}.yaml")
    if path.exists() and not overwrite:
        raise NewScenarioError(f"{path}: exists: choose another name, or overwrite it")
    text = text_of(named(path), shape, n, spacing_m, path.parent)
    with replacing(path, folder=True) as part:
        part.write_text(text, encoding="utf-8")
    return path


def named(path: Path) -> str:
    """The name of a scenario in a file: the file's own, with what a name cannot have replaced."""
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in path.stem)
    return kept[:64] or "scenario"
