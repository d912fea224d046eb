"""The formation tasks: one row each, from which everything that names them follows. Imports nothing heavy.

The task NAME is the function NAME of the module NAME of this folder, a `kernel` that gives a `TaskGeometry`. A new task
is such a module and a row here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple


class FormationTask(NamedTuple):
    """One formation task: its name, and the units of its rows."""

    name: str
    angles: tuple[bool, bool, bool]
    """Rows that are angles at the horizontal arm to the parent: times the arm they are metres."""

    @property
    def needs_arm(self) -> bool:
        """True if the task has no meaning for a place straight above or below the parent."""
        return any(self.angles)

    def row_scale(self, arm_m: float) -> tuple[float, float, float]:
        """Factors that put every row in metres."""
        first, second, third = (arm_m if angle else 1.0 for angle in self.angles)
        return first, second, third


_ROWS = (
    FormationTask("distance_angles", angles=(False, True, True)),
    FormationTask("parent_angle", angles=(False, True, False)),
    FormationTask("relative_position", angles=(False, False, False)),
)

FORMATION_TASKS = {row.name: row for row in _ROWS}
TASKS = {name: number for number, name in enumerate(FORMATION_TASKS)}
"""Number of each task: `AgentConfig.task`."""

if TYPE_CHECKING:
    TaskName = str
else:
    TaskName = Literal[tuple(TASKS)]
    """Type of the keys and options that name a task."""
