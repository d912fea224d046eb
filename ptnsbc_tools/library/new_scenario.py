"""A scenario file to begin with: a shape of so many UAVs, and every block with a comment."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_io.files import replacing
from ptnsbc_sim.scenario.mission.shapes import SHAPES
from ptnsbc_sim.scenario.problems import similar
from ptnsbc_sim.scenario.schema import FILE

MOST = 254
_RADIUS_M, _HEIGHT_M, _START_M = 5.0, 6.0, 1.0


class NewScenarioError(PtnsbcError):
    """A scenario that cannot be made."""


def text_of(name: str, shape: str = "v", n: int = 5, spacing_m: float = 2.0) -> str:
    """The file of a new scenario: it passes `ptnsbc check`, and every block has a comment; arguments as of `new`."""
    if shape not in SHAPES:
        raise NewScenarioError(f"--shape {shape}: {similar(shape, SHAPES)}")
    if not 2 <= n <= MOST:
        raise NewScenarioError(f"--n {n}: expected 2 to {MOST} UAVs")
    if not 1.0 <= spacing_m <= 100.0:
        raise NewScenarioError(f"--spacing {spacing_m:g}: expected 1 to 100 m")
    places = SHAPES[shape](n, spacing_m)
    lowest = float(places[:, 2].min())
    height_m = _HEIGHT_M + max(-lowest - _HEIGHT_M + 2.0 * _START_M, 0.0)  # no place in the ground
    starts = np.round(places + np.array([0.0, _RADIUS_M, _START_M - lowest]), 2) + 0.0
    return _TEXT.format(
        schema=FILE,
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
    path = given if given.suffix in (".yaml", ".yml") else given.with_name(f"{given.name}.yaml")
    if path.exists() and not overwrite:
        raise NewScenarioError(f"{path}: exists: choose another name, or --overwrite")
    text = text_of(named(path), shape, n, spacing_m)
    with replacing(path, folder=True) as part:
        part.write_text(text, encoding="utf-8")
    return path


def named(path: Path) -> str:
    """The name of a scenario in a file: the file's own, with what a name cannot have replaced."""
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in path.stem)
    return kept[:64] or "scenario"


_TEXT = """\
# yaml-language-server: $schema={schema}
# {n} UAVs, shape {shape}, neighbours {spacing} m apart. docs/scenarios.md explains every key.
# ptnsbc check FILE, then ptnsbc simulate FILE, then ptnsbc fleet FILE.
name: {name}
description: {n} UAVs, shape {shape}
seed: 1                       # of all random numbers: noise, gusts, losses

timing:
  control_hz: 100             # rate of the laws
  physics_hz: 500             # rate of the simulated vehicle
  duration_s: 30

world:
  wind_m_s: [0, 0, 0]         # mean wind: east, north, up
  gust_m_s: [0, 0, 0]         # standard deviation of the gusts
  obstacles: []               # e.g. [{{name: tree, position_m: [8, 0, 6], keep_out_m: 1.5}}]

sensor:                       # what a UAV sees of others and of obstacles
  range_m: 6
  rate_hz: 20

plant:
  kind: quadrotor
  mass_kg: 1.2
  inertia_kg_m2: [0.019, 0.019, 0.021]
  quadrotor:
    max_thrust_n: 25.9        # 2.2 times the weight
    max_tilt_rad: 0.698       # 40 degrees
    max_torque_nm: [1.5, 1.5, 0.3]
    motor_lag_s: 0.02
    drag_1_s: 0.1

communication:
  tree: auto                  # or child: parent, rooted at the leader
  leader_links: [{links}]  # who receives the leader's state
  estimator_edges: [{edges}]  # who exchanges estimates of the leader
  loss: 0                     # fraction of messages that is lost
  delay_s: 0

leader:
  id: 1
  trajectory: {{kind: circle, centre_m: [0, 0, {height}], radius_m: {radius}, rate_rad_s: 0.1}}
  # or: {{kind: line, position_m: [0, {radius}, {height}], velocity_m_s: [0.5, 0, 0]}}

formation:
  task: relative_position     # or {other_tasks}
  avoidance: set_based        # or switched, off
  uav_keep_out_m: 0.5         # least distance of two UAVs, between centres
  tolerance_m: 0.05           # largest error at the deadline
  shape: {{kind: {shape}, spacing_m: {spacing}}}  # or offsets_m, the place of every follower: east, north, up

gains:
  formation: {{deadline_s: 6}}  # complete by then; auto: 1.5 times the shortest possible

uavs:                         # starts: here below the places, so that nobody crosses another's way
{starts}
"""
