"""A scenario file to begin with: a shape of so many UAVs, and every block with a comment."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.tasks.table import TASKS
from ptnsbc_io.files import replacing
from ptnsbc_sim.scenario.problems import similar
from ptnsbc_sim.scenario.schema import FILE

MOST = 254
_RADIUS_M, _HEIGHT_M, _START_M = 5.0, 6.0, 1.0

Offset = tuple[float, float, float]


class NewScenarioError(PtnsbcError):
    """A scenario that cannot be made."""


def _vee(k: int, n: int, spacing_m: float) -> Offset:
    arm, side = (k + 1) // 2, -1.0 if k % 2 else 1.0
    step = spacing_m / math.sqrt(2.0)
    return -arm * step, side * arm * step, 0.0


def _line(k: int, n: int, spacing_m: float) -> Offset:
    arm, side = (k + 1) // 2, -1.0 if k % 2 else 1.0
    return 0.0, side * arm * spacing_m, 0.0


def _column(k: int, n: int, spacing_m: float) -> Offset:
    return -k * spacing_m, 0.0, 0.0


def _circle(k: int, n: int, spacing_m: float) -> Offset:
    apart = 2.0 * math.pi / (n - 1)
    radius = max(spacing_m, spacing_m / (2.0 * math.sin(apart / 2.0)) if n > 2 else spacing_m)
    return radius * math.cos(k * apart), radius * math.sin(k * apart), 0.0


def _grid(k: int, n: int, spacing_m: float) -> Offset:
    row, column = divmod(k, math.ceil(math.sqrt(n)))
    return -row * spacing_m, -column * spacing_m, 0.0


SHAPES: dict[str, Callable[[int, int, float], Offset]] = {
    "v": _vee,
    "line": _line,
    "column": _column,
    "circle": _circle,
    "grid": _grid,
}
"""Offset of follower number k = 1 … n - 1 relative to the leader [m], ENU, east being ahead."""


def places(shape: str, n: int, spacing_m: float) -> dict[int, Offset]:
    """Offset of UAV 2 … n relative to the leader [m], ENU.

    Raises:
        NewScenarioError: an unknown shape, too few or too many UAVs, or no distance between them.
    """
    if shape not in SHAPES:
        raise NewScenarioError(f"--shape {shape}: {similar(shape, SHAPES)}")
    if not 2 <= n <= MOST:
        raise NewScenarioError(f"--n {n}: expected 2 to {MOST} UAVs")
    if not 1.0 <= spacing_m <= 100.0:
        raise NewScenarioError(f"--spacing {spacing_m:g}: expected 1 to 100 m")
    found = {k + 1: SHAPES[shape](k, n, spacing_m) for k in range(1, n)}
    return {uav: (round(x, 2) + 0.0, round(y, 2) + 0.0, z) for uav, (x, y, z) in found.items()}


def _parents(at: dict[int, Offset]) -> dict[int, int]:
    """The nearest UAV with a lower id, the leader being at the origin: the tree of the formation."""
    known: dict[int, Offset] = {1: (0.0, 0.0, 0.0)}
    parents = {}
    for uav, place in at.items():
        parents[uav] = min(known, key=lambda one: (round(math.dist(known[one], place), 6), one))
        known[uav] = place
    return parents


def _vector(place: Offset) -> str:
    return f"[{', '.join(f'{number:g}' for number in place)}]"


def text_of(name: str, shape: str = "v", n: int = 5, spacing_m: float = 2.0) -> str:
    """The file of a new scenario: it passes `ptnsbc check`, and every block has a comment.

    Args:
        name: of the scenario.
        shape: a key of `SHAPES`.
        n: UAVs with the leader.
        spacing_m: distance of neighbours.

    Raises:
        NewScenarioError: see `places`.
    """
    at = places(shape, n, spacing_m)
    parents = _parents(at)
    edges = [[parents[uav], uav] for uav in at if parents[uav] != 1]
    offsets = "\n".join(f"    {uav}: {_vector(place)}" for uav, place in at.items())
    starts = "\n".join(
        f"  - {{id: {uav}, position_m: {_vector((x, y + _RADIUS_M, _START_M))}}}"
        for uav, (x, y, _) in {1: (0.0, 0.0, 0.0), **at}.items()
    )
    return _TEXT.format(
        schema=FILE,
        name=name,
        shape=shape,
        n=n,
        spacing=f"{spacing_m:g}",
        tree=", ".join(f"{uav}: {parent}" for uav, parent in parents.items()),
        links=", ".join(map(str, at)),
        edges=", ".join(map(str, edges)),
        height=f"{_HEIGHT_M:g}",
        radius=f"{_RADIUS_M:g}",
        offsets=offsets,
        other_tasks=", ".join(task for task in TASKS if task != "relative_position"),
        starts=starts,
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
        shape: v, line, column, circle or grid.
        n: UAVs with the leader.
        spacing_m: distance of neighbours.
        overwrite: replace an existing file.

    Raises:
        NewScenarioError: an unknown shape, or a file that exists.
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
  tree: {{{tree}}}  # child: parent, rooted at the leader
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
  offsets_m:                  # place of every follower relative to the leader: east, north, up
{offsets}

gains:
  formation: {{deadline_s: 6}}  # complete by then; auto: 1.5 times the shortest possible

uavs:                         # starts: here below the places, so that nobody crosses another's way
{starts}
"""
