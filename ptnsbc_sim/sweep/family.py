"""Families of scenarios: a small YAML file of distributions over size, tree, shape, starts, path and surroundings.

A family replaces the UAVs, the tree, the shape, the leader's path and, where it names them, the deadline, the
obstacles and the wind of the base scenario. Vehicle, sensors, gains and task stay the base scenario's.
`family.schema.json` beside this module is the JSON schema of a family, for editors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from ptnsbc_core.tasks.table import TaskName
from ptnsbc_sim.scenario.fields import Block, Count, Name, NotNegative, Number, Positive
from ptnsbc_sim.scenario.problems import ScenarioError, scenario_error
from ptnsbc_sim.scenario.reading import reader
from ptnsbc_sim.scenario.schema import as_text, described, headed

# A range is [low, high]; a number alone is that number in every draw.
Range = Annotated[
    Number | tuple[Number, Number], Field(description="a number, or [low, high] to draw from")
]
CountRange = Annotated[Count | tuple[Count, Count], Field(description="a number, or [low, high]")]


class FamilyTree(Block):
    """The parent of every follower."""

    kinds: tuple[Literal["chain", "star", "random"], ...] = ("random",)
    """One of these is drawn. Followers hear the leader, and the next and the last one by number."""
    depth: Count = 3
    """Most hops from the leader, of a random tree."""


class FamilyShape(Block):
    """The formation."""

    kinds: tuple[Literal["v", "line", "column", "grid", "circle", "sphere", "random"], ...] = ("v",)
    """One of these is drawn: those of `formation.shape`, or `random` places."""
    spacing_m: Range = 2.0
    """Between neighbours in the shape; of the random shape the least distance."""


class FamilyStarts(Block):
    """The starts of the UAVs."""

    kind: Literal["near", "box", "swap", "opposite"] = "near"
    """Beside their places, anywhere in a box, each follower at the place of another one, or across the leader."""
    sigma_m: Range = 0.5
    """Of `near`, `swap` and `opposite`: standard deviation per axis."""
    box_m: tuple[Positive, Positive, Positive] = (10.0, 10.0, 4.0)
    """Of `box`: its edges; the lowest places of the formation lie at its bottom."""
    apart_m: NotNegative = 0.0
    """Least distance between two starts, where it is more than formation.uav_keep_out_m and the margin."""


class FamilyPath(Block):
    """The path of the leader."""

    kinds: tuple[Literal["hover", "line", "circle"], ...] = ("hover",)
    """One of these is drawn."""
    speed_m_s: Range = (0.2, 1.0)
    """Of a line, in any horizontal direction, and along a circle."""
    radius_m: Range = (3.0, 8.0)
    """Of a circle."""


class FamilyDeadline(Block):
    """The promise: one of the two."""

    seconds: Range | None = None
    """Absolute."""
    of_feasible: Range | None = None
    """Multiple of the shortest that the speed and acceleration limits allow for the largest start error."""
    at_least_s: NotNegative = 1.0
    """With `of_feasible`: never shorter."""
    after_s: Positive = 10.0
    """The flight ends so long after the deadline."""

    @model_validator(mode="after")
    def _one(self) -> FamilyDeadline:
        if (self.seconds is None) == (self.of_feasible is None):
            raise ValueError("expected one of seconds and of_feasible")
        return self


class FamilyObstacles(Block):
    """Spheres to keep out of."""

    count: CountRange
    """Number of obstacles, as far as there is room for them: the table tells how many there were."""
    keep_out_m: Range = (0.5, 1.5)
    """Radius."""
    where: Literal["way", "anywhere"] = "way"
    """Between starts and places, or anywhere around both."""


class FamilyWind(Block):
    """Wind from any horizontal direction."""

    mean_m_s: Range = 0.0
    """Speed."""
    gust_m_s: Range = 0.0
    """Standard deviation of the gusts, per axis."""


class FamilyMass(Block):
    """True mass and inertia over what the laws know, drawn for each UAV, and for each axis of it."""

    mass_scale: Range = 1.0
    """Of the mass."""
    inertia_scale: Range = 1.0
    """Of the moments of inertia."""


class Family(Block):
    """A family of scenarios."""

    name: Name
    """Of the family."""
    description: str = ""
    """For people."""
    size: CountRange = 5
    """UAVs, the leader among them."""
    tree: FamilyTree = FamilyTree()
    """The parent of every follower."""
    shape: FamilyShape = FamilyShape()
    """The formation."""
    starts: FamilyStarts = FamilyStarts()
    """The starts of the UAVs."""
    path: FamilyPath = FamilyPath()
    """The path of the leader."""
    task: TaskName | None = None
    """formation.task; the base scenario's without it."""
    assignment: Literal["fixed", "optimal"] | None = None
    """formation.assignment; the base scenario's without it."""
    deadline: FamilyDeadline | None = None
    """The promise; the base scenario's without it."""
    obstacles: FamilyObstacles | None = None
    """Spheres to keep out of; none without it."""
    delay_s: Range | None = None
    """Delay of the messages between UAVs; the base scenario's without it."""
    wind: FamilyWind | None = None
    """The base scenario's wind without it."""
    mass: FamilyMass | None = None
    """True mass and inertia; those of the base scenario's UAVs without it."""


def families() -> list[str]:
    """The names of the families that can be given without a path."""
    folders = (folder / "families" for folder in reader.folders()[:-1])
    return sorted({path.stem for folder in folders for path in folder.glob("*.yaml")})


def find_family(name: str | Path) -> Path:
    """The file of a family, given by path or by name."""
    given = Path(name).expanduser()
    if len(given.parts) > 1 or given.suffix:
        if given.is_file():
            return given
        raise ScenarioError(f"{given}: no such family file")
    for folder in reader.folders()[:-1]:
        path = folder / "families" / f"{given}.yaml"
        if path.is_file():
            return path
    known = ", ".join(families()) or "none is installed, give a path"
    raise ScenarioError(f"{given}: no family of this name; expected one of: {known}")


def family_from_text(text: str, source: str = "family") -> Family:
    """A family from YAML text.

    Raises:
        ScenarioError: the text is no family.
    """
    tree = reader.parse(text, source)
    try:
        return Family.model_validate(tree)
    except ValidationError as error:
        raise scenario_error(source, error, tree) from None


FILE = Path(__file__).with_name("family.schema.json")
"""The schema that the modeline of a family file names."""


def schema() -> dict[str, Any]:
    """JSON schema, draft 2020-12, of a family file."""
    told = "Distributions of scenarios, for ptnsbc sweep --family. docs/sweeps.md explains it."
    return headed(described(Family), "Family of scenarios of ptnsbc", told)


def text() -> str:
    """The schema as the committed file holds it."""
    return as_text(schema())
