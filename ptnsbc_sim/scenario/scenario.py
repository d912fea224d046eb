"""A scenario: read from text or a file, changed by keys, and as its legs go on in flight."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from operator import attrgetter, is_
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, ValidationError

from ptnsbc_core.nanoseconds import nanoseconds
from ptnsbc_core.topology import Topology
from ptnsbc_sim.scenario.approach.deadline import auto_deadline
from ptnsbc_sim.scenario.fields import replaced
from ptnsbc_sim.scenario.gains import gain_defaults
from ptnsbc_sim.scenario.mission.completion import resolved, with_first_leg
from ptnsbc_sim.scenario.mission.legs import LandLeg, ScheduledLeg, TakeOffLeg, Word, schedule
from ptnsbc_sim.scenario.mission.route import with_route
from ptnsbc_sim.scenario.mission.stream import (
    Setpoint,
    Streamed,
    going_on,
    streamed,
    takes_setpoints,
)
from ptnsbc_sim.scenario.model import ScenarioFile, UavBlock
from ptnsbc_sim.scenario.problems import ScenarioError, Tree, scenario_error, shown
from ptnsbc_sim.scenario.reading import reader
from ptnsbc_sim.scenario.reading.content import (
    names_table,
    refuse_functions,
    refuse_new_functions,
    with_code,
    with_shape,
    with_table,
    without_folder,
)
from ptnsbc_sim.scenario.reading.places import with_places
from ptnsbc_sim.scenario.semantics import checked

_DEADLINE = "gains.formation.deadline_s"


def validated(tree: Tree, source: str) -> ScenarioFile:
    """The file that a tree holds, with default gains and all that it leaves to us but the deadline.

    Raises:
        ScenarioError: the first key or value that is malformed.
    """
    gains, plant = tree.get("gains"), tree.get("plant")
    if isinstance(gains, dict):
        kind = plant.get("kind") if isinstance(plant, dict) else None
        tree = {**tree, "gains": reader.merged(gain_defaults(str(kind)), gains)}
    tree = with_first_leg(tree)
    try:
        return resolved(ScenarioFile.model_validate(tree), source)
    except ValidationError as error:
        raise scenario_error(source, error, tree) from None


_beside_starts = attrgetter(*set(ScenarioFile.model_fields) - {"uavs", "seed"})
_beside_position = attrgetter(*set(UavBlock.model_fields) - {"position_m"})


class Scenario(ScenarioFile):
    """One flight: the content of its file, and what was said to it in flight. Immutable and validated.

    The blocks and keys of the file are attributes: `scenario.timing.duration_s`.
    """

    model_config = ConfigDict(defer_build=True)  # built from a validated file, never validated

    topology: Topology
    """The communication graph."""
    text: str
    """YAML after `extends` and overrides: loads again to the same scenario; attached to bags."""
    source: str
    """The file or text that it was read from, for messages."""
    words: tuple[Word, ...] = ()
    """The words of an operator about its legs, in flight."""

    def __eq__(self, other: object) -> bool:
        """True for the same content, from whatever text it was read."""
        return isinstance(other, Scenario) and all(
            getattr(self, key) == getattr(other, key) for key in ScenarioFile.model_fields
        )

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        return (("name", self.name), ("source", self.source))

    def with_(self, keys: Mapping[str, Any] | None = None, /, **more: Any) -> Scenario:
        """This scenario with dotted keys set: `with_({"gains.formation.deadline_s": 6}, seed=3)`.

        Args:
            keys: values by dotted key; numbers, text, lists and NumPy arrays.
            more: the same, as keywords.

        Raises:
            ScenarioError: an unknown key, or a value that does not fit.
        """
        if not isinstance(keys, Mapping | None):
            raise ScenarioError(
                f"with_: {shown(keys)}: expected values by dotted key, as in {{'seed': 3}}"
            )
        changes = {str(key): reader.plain(value) for key, value in {**(keys or {}), **more}.items()}
        return scenario_from_text(self.text, changes, source=self.source)

    def shares_all_but_starts(self, other: Scenario) -> bool:
        """True if `other` has the very objects of this scenario, but for seed, start positions and text.

        A scenario that was read anew shares nothing, even where it says the same.
        """
        return (
            self.topology is other.topology
            and len(self.uavs) == len(other.uavs)
            and all(map(is_, _beside_starts(self), _beside_starts(other)))
            and all(
                all(map(is_, _beside_position(uav), _beside_position(twin)))
                for uav, twin in zip(self.uavs, other.uavs, strict=True)
            )
        )

    def with_words(self, words: Iterable[Word]) -> Scenario:
        """This scenario as its legs go on after what an operator said; its text stays that of the whole flight.

        Raises:
            ScenarioError: the path of the leader gets too long.
        """
        words = tuple(words)
        if words == self.words:
            return self
        return with_route(self, self.source, words).model_copy(update={"words": words})

    def with_setpoints(self, setpoints: Iterable[Setpoint]) -> Scenario:
        """This scenario with the setpoints that its leader, of kind `stream`, has taken from a topic.

        Raises:
            SetpointError: one that the leader cannot follow.
        """
        path: Any = self.leader.trajectory
        path = streamed(getattr(path, "block", path), tuple(setpoints))
        return replaced(self, {"leader.trajectory": path})

    def with_setpoint(self, setpoint: Setpoint) -> Scenario:
        """The same with one more setpoint, in flight: what is long past is forgotten.

        Raises:
            SetpointError: the leader cannot follow it.
        """
        path: Any = self.leader.trajectory
        path = going_on(path if isinstance(path, Streamed) else streamed(path, ()), setpoint)
        return replaced(self, {"leader.trajectory": path})

    @property
    def takes_setpoints(self) -> bool:
        """True if its leader takes setpoints from a topic."""
        return takes_setpoints(self.leader.trajectory)

    @property
    def legs(self) -> tuple[ScheduledLeg, ...]:
        """The legs of its mission that begin, in their order; none without a mission."""
        if self.mission is None:
            return ()
        return schedule(self.mission, self.gains.formation.deadline_s, self.words)

    @property
    def landing_ns(self) -> int | None:
        """The time at which the leg `land` begins, after the first epoch [ns]; None without one."""
        begins_s = (one.begin_s for one in self.legs if isinstance(one.leg, LandLeg))
        return next(map(nanoseconds, begins_s), None)

    def bridged(self, *, ros: bool = False) -> Scenario:
        """The scenario for real vehicles, with `mavlink.overrides` applied; applying them again changes nothing.

        A leg `take_off` begins where their own take-off ends. `ros`: they are behind the topics of the block `ros`.

        Raises:
            ScenarioError: an override does not fit.
        """
        overrides = {**self.mavlink.overrides, **({"mavlink.autopilot": "ros"} if ros else {})}
        first = None if self.mission is None else self.mission.legs[0]
        if isinstance(first, TakeOffLeg) and first.from_m is None:
            overrides["mission.legs[0].from_m"] = self.mavlink.takeoff_height_m
        return scenario_from_text(self.text, overrides, source=self.source) if overrides else self


def scenario_from_text(
    text: str,
    overrides: Mapping[str, Any] | None = None,
    *,
    source: str = "scenario",
    folder: Path | None = None,
    complete: bool = False,
) -> Scenario:
    """A scenario from YAML text.

    Args:
        text: YAML.
        overrides: Values by dotted key.
        source: Where it comes from, for messages.
        folder: Where files that it extends are searched first. Without it the text names no code to execute.
        complete: The text comes from outside, such as from a bag: it must not name files to read.
    """
    tree = reader.parse(text, source)
    if complete and "extends" in tree:
        raise ScenarioError(
            f"{source}: extends: not here: expected a whole scenario, no other file"
        )
    if complete and (named := names_table(tree)):
        raise ScenarioError(f"{source}: {named}: not here: expected samples, no other file")
    if complete or folder is None:
        refuse_functions(tree, source)
    given = {key: value for key, value in (overrides or {}).items() if value is not None}
    final = reader.extended(tree, source, folder or Path.cwd())
    if complete:
        final = without_folder(final)
    elif folder is not None:
        final = with_code(final, folder)
    if given:
        final = with_table(reader.overridden(final, given, source), source, Path.cwd())
        refuse_new_functions(final, given, source)
        final = with_code(final, Path.cwd(), given)
    final = with_shape(with_places(final, source), source)
    file = validated(final, source)
    if math.isinf(file.gains.formation.deadline_s):
        first = replaced(file, {_DEADLINE: 1.0})
        checked(first, source)
        deadline_s = auto_deadline(with_route(first, source), source)
        file = replaced(file, {_DEADLINE: deadline_s})
        final = reader.overridden(final, {_DEADLINE: deadline_s}, source)
    return scenario_of(file, reader.dump(final) if given or final != tree else text, source)


def scenario_of(file: ScenarioFile, text: str, source: str) -> Scenario:
    """The scenario of a whole file.

    Raises:
        ScenarioError: what is in the file does not fit together.
    """
    topology = checked(file, source)
    content = dict(with_route(file, source))
    return Scenario.model_construct(**content, topology=topology, text=text, source=source)


def load_scenario(path_or_name: str | Path, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """A scenario by path or name (`paper_5`), with dotted keys overridden (`gains.profile`)."""
    path = reader.find(path_or_name)
    text = reader.read_text(path)
    return scenario_from_text(text, overrides, source=_shown(path), folder=path.parent)


def _shown(path: Path) -> str:
    """A path as short as it can be named from here."""
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)
