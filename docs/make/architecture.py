"""The tables of topics in `docs/architecture.md`."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterable, Iterator
from functools import cache
from itertools import pairwise
from types import ModuleType
from typing import NamedTuple

from docs.make.graph import BRIDGED, LOCKSTEP, REAL_TIME, End, ends
from docs.make.markdown import table
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.topics import Role, Topic

_N = 0  # stands for the number of a UAV in the names below
_NODES = ("uav", "bridge", "sim", "recorder", "launcher")
_ONLY = {
    frozenset({LOCKSTEP}): "in lock-step",
    frozenset({REAL_TIME, BRIDGED}): "in real time",
    frozenset({REAL_TIME}): "in real time",
}


class TopicsError(Exception):
    """The nodes use topics in a way that the tables cannot show."""


class Known(NamedTuple):
    """A topic and the docstring that stands by it."""

    topic: Topic
    meaning: str


def regions() -> dict[str, str]:
    """Every made region of the page."""
    found = [end for end in ends() if end.topic != topics.TF.name]  # not on every machine
    known = {one.topic.name.replace(f"/uav{_N}/", "/uavN/"): one for one in _known()}
    live = {end.topic for end in found}
    if live - set(known) or set(known) - live - {topics.TF.name}:
        raise TopicsError(f"topics of the nodes and of topics.py differ: {live ^ set(known)}")
    rows = (
        _row(name, one, [end for end in found if end.topic == name]) for name, one in known.items()
    )
    return {
        "topics": table(("Topic", "Type", "QoS", "From", "To", "Rate", "What"), rows),
        "qos": _qos(found, {name: one.topic.role for name, one in known.items()}),
    }


def _known() -> Iterator[Known]:
    """The topics that the code names: those of a UAV first."""
    for name, law in vars(topics).items():
        if not name.startswith("_") and _gives_topic(law):
            yield Known(law(_N), inspect.getdoc(law) or "")
    meanings = _docstrings(topics)
    for name, one in vars(topics).items():
        if isinstance(one, Topic):
            yield Known(one, meanings[name])


def _gives_topic(law: object) -> bool:
    if not inspect.isfunction(law) or law.__module__ != topics.__name__:
        return False
    return law.__annotations__ == {"uav": "int", "return": "Topic"}


@cache
def _docstrings(module: ModuleType) -> dict[str, str]:
    """The docstring under each constant of a module."""
    body = ast.parse(inspect.getsource(module)).body
    return {
        target.id: " ".join(str(text.value.value).split())
        for assigned, text in pairwise(body)
        if isinstance(assigned, ast.Assign)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        for target in assigned.targets
        if isinstance(target, ast.Name)
    }


def _row(name: str, known: Known, found: list[End]) -> tuple[str, ...]:
    sent = _nodes_of(name, [end for end in found if end.publishes])
    received = _nodes_of(name, [end for end in found if not end.publishes])
    kind = known.topic.type.replace("/msg/", "/")
    return (
        f"`{name}`",
        kind,
        known.topic.role.value,
        sent,
        received,
        known.topic.rate,
        known.meaning,
    )


def _nodes_of(name: str, found: list[End]) -> str:
    said = []
    for node in _NODES:
        for own in (True, False):
            these = [end for end in found if end.node == node and end.own == own]
            if these:
                modes = frozenset(end.mode for end in these)
                when = "" if node in ("bridge", "recorder") else _ONLY.get(modes, "")
                said.append(" ".join(filter(None, (_label(name, node, own, these), when))))
    return ", ".join(said)


def _label(name: str, node: str, own: bool, these: list[End]) -> str:
    if node not in ("uav", "bridge"):
        return node
    word = {"uav": "UAV", "bridge": "bridge"}[node]
    if own:
        return f"{word} N"
    if name.startswith("/uavN/"):
        return f"other {word}s"
    return "leader" if node == "uav" and all(end.leads for end in these) else f"{word}s"


def _qos(found: list[End], roles: dict[str, Role]) -> str:
    headings = (
        "QoS",
        "Publishers",
        "in lock-step",
        "Subscribers",
        "in lock-step",
        "Recorder",
        "in lock-step",
    )
    return table(headings, (_profiles(found, roles, role) for role in Role))


def _profiles(found: list[End], roles: dict[str, Role], role: Role) -> tuple[str, ...]:
    of_role = [
        end for end in found if roles[end.topic] is role and end.node in ("uav", "sim", "recorder")
    ]
    cells = []
    for publishes, recording in ((True, False), (False, False), (False, True)):
        these = [
            end
            for end in of_role
            if (end.publishes, end.node == "recorder") == (publishes, recording)
        ]
        for lockstep in (False, True):
            chosen = (end for end in these if (end.mode == LOCKSTEP) == lockstep)
            cells.append(_one(chosen, f"{role.value} topics"))
    return role.value, *cells


def _one(found: Iterable[End], what: str) -> str:
    """The profile that all of `found` have; in two depths where that is all that differs."""
    profiles = {_profile(end.profile): end.profile for end in found}
    kinds = {(one.reliability, one.durability) for one in profiles.values()}  # type: ignore[attr-defined]
    if len(kinds) > 1:
        raise TopicsError(f"{what}: several profiles, {', '.join(sorted(profiles))}: expected one")
    first, *more = sorted(profiles, key=lambda name: -profiles[name].depth) or [""]  # type: ignore[attr-defined]
    return " or ".join([first, *(name.rpartition("depth ")[2] for name in more)])


def _profile(profile: object) -> str:
    reliability = profile.reliability.name.lower().replace("_", " ")  # type: ignore[attr-defined]
    durability = profile.durability.name.lower().replace("_", " ")  # type: ignore[attr-defined]
    latched = "" if durability == "volatile" else f"{durability}, "
    return f"{reliability}, {latched}depth {profile.depth}"  # type: ignore[attr-defined]
