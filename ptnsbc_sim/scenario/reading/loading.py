"""Text to a file of validated blocks: `extends`, overrides, defaults, and what the file leaves to us."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from ptnsbc_sim.scenario.approach.deadline import AUTO, auto_deadline
from ptnsbc_sim.scenario.mission.completion import completed_mission, completed_shape
from ptnsbc_sim.scenario.mission.legs import Word
from ptnsbc_sim.scenario.mission.route import with_legs
from ptnsbc_sim.scenario.model import ScenarioFile
from ptnsbc_sim.scenario.problems import ScenarioError, Tree, scenario_error
from ptnsbc_sim.scenario.reading import functions, reader
from ptnsbc_sim.scenario.reading.defaults import gain_defaults
from ptnsbc_sim.scenario.reading.named_files import names_table, with_table
from ptnsbc_sim.scenario.semantics import checked

_File = TypeVar("_File", bound=ScenarioFile)


def load_text(
    text: str, overrides: Mapping[str, Any] | None, source: str, folder: Path | None, complete: bool
) -> tuple[ScenarioFile, str]:
    """A validated file, not yet checked, and the YAML text that loads again to it.

    The arguments are those of `scenario_from_text`.
    """
    tree = reader.parse(text, source)
    if complete and "extends" in tree:
        raise ScenarioError(
            f"{source}: extends: not here: expected a whole scenario, no other file"
        )
    if complete and (named := names_table(tree)):
        raise ScenarioError(f"{source}: {named}: not here: expected samples, no other file")
    if complete or folder is None:
        functions.refuse_functions(tree, source)
    given = {key: value for key, value in (overrides or {}).items() if value is not None}
    final = reader.extended(tree, source, folder or Path.cwd())
    if complete:
        final = functions.without_folder(final)
    elif folder is not None:
        final = functions.with_code(final, folder)
    if given:
        final = with_table(reader.overridden(final, given, source), source, Path.cwd())
        functions.refuse_new_functions(final, given, source)
        final = functions.with_code(final, Path.cwd(), given)
    final = functions.with_shape(final, source)
    if (
        given
        or "extends" in tree
        or names_table(tree)
        or functions.names_function(tree)
        or functions.named_functions(final) != functions.named_functions(tree)
    ):
        text = reader.dump(final)
    filled = completed(final, source)
    if _deadline_of(filled) == AUTO:
        first = _validated(_with_deadline(filled, 1.0), source)
        if first.mission is not None:
            checked(first, source)
            first = with_route(first, source)
        deadline_s = auto_deadline(first, source)
        filled = _with_deadline(filled, deadline_s)
        text = reader.dump(_with_deadline(final, deadline_s))
    return _validated(filled, source), text


def completed(tree: Tree, source: str = "scenario") -> Tree:
    """`tree` with default gains, the offsets of shapes, and a tree of communication that was left to us.

    Blocks of the wrong type are left for the validation to name.
    """
    plant, gains = tree.get("plant"), tree.get("gains")
    kind = plant.get("kind") if isinstance(plant, dict) else None
    if isinstance(gains, dict):
        tree = {**tree, "gains": reader.merged(gain_defaults(str(kind)), gains)}
    return completed_shape(completed_mission(tree, source), source)


def with_route(file: _File, source: str, words: tuple[Word, ...] = ()) -> _File:
    """A checked file with the trajectory and the changes of the shape of its mission.

    Raises:
        ScenarioError: the path of the leader gets too long.
    """
    try:
        routed: _File = with_legs(file, words)
    except ValueError as error:
        raise ScenarioError(f"{source}: {error}") from None
    return routed


def _validated(tree: Tree, source: str) -> ScenarioFile:
    try:
        return ScenarioFile.model_validate(tree)
    except ValidationError as error:
        raise scenario_error(source, error, tree) from None


def _deadline_of(tree: Tree) -> Any:
    """gains.formation.deadline_s as it is written; None where the blocks are not there."""
    gains = tree.get("gains")
    loop = gains.get("formation") if isinstance(gains, dict) else None
    return loop.get("deadline_s") if isinstance(loop, dict) else None


def _with_deadline(tree: Tree, deadline_s: float) -> Tree:
    gains = tree["gains"]
    return {
        **tree,
        "gains": {**gains, "formation": {**gains["formation"], "deadline_s": deadline_s}},
    }
