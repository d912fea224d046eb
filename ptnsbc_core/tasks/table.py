"""The table of the formation tasks: a line each, from which everything that names them follows. Imports nothing heavy.

A new task is a class in `formation_tasks` and a line here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

CLASSES = {
    "distance_angles": "DistanceAngles",
    "parent_angle": "ParentAngle",
    "relative_position": "RelativePosition",
}
"""The class of each task in `formation_tasks`."""

TASKS = {name: number for number, name in enumerate(CLASSES)}
"""Number of each task: `AgentConfig.task`."""

if TYPE_CHECKING:
    TaskName = str
else:
    TaskName = Literal[tuple(TASKS)]
    """Type of the keys and options that name a task."""
