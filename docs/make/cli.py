"""The commands in `docs/cli.md`: usage, description and options, of the signatures that Typer reads too."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from types import NoneType
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from typer import Context
from typer.models import ArgumentInfo

from docs.make.markdown import table
from paper.command import app as paper
from ptnsbc_tools.cli import functions

_HEADINGS = ("Option", "Value", "Default", "Meaning")


class Parameter(NamedTuple):
    """One option or argument of a command."""

    name: str  # of the variable
    kind: Any  # without None and without list
    info: Any  # Typer's ArgumentInfo or OptionInfo
    default: Any  # inspect.Parameter.empty where it is required

    @property
    def is_argument(self) -> bool:
        """Given without a name."""
        return isinstance(self.info, ArgumentInfo)

    @property
    def is_required(self) -> bool:
        """Without it the command is refused."""
        return self.default is inspect.Parameter.empty

    @property
    def word(self) -> str:
        """The word that stands for its value."""
        names = {int: "INTEGER", float: "NUMBER"}
        return self.info.metavar or names.get(self.kind, self.name.upper())


def regions() -> dict[str, str]:
    """Every made region of the page, one for each command."""
    found = dict(functions())
    found["reproduce"] = paper.registered_commands[0].callback  # its words go there
    return {path.replace(" ", "-"): _told(path, law) for path, law in found.items()}


def _parameters(command: Callable[..., Any]) -> Iterator[Parameter]:
    hints = get_type_hints(command, include_extras=True)
    for name, one in inspect.signature(command).parameters.items():
        if hints[name] is Context:
            continue
        kind, info = get_args(hints[name])
        if getattr(info, "hidden", False):
            continue
        kinds = [part for part in get_args(kind) if part is not NoneType]
        if NoneType in get_args(kind):
            (kind,) = kinds
        if get_origin(kind) is list:
            (kind,) = get_args(kind)
        yield Parameter(name, kind, info, one.default)


def _told(path: str, command: Callable[..., Any]) -> str:
    given = sorted(_parameters(command), key=lambda one: not one.is_argument)
    words = [f"ptnsbc {path}", *(_place(one) for one in given if one.is_argument)]
    description = inspect.cleandoc(command.__doc__ or "")
    rows = (_row(one) for one in given)
    return f"`{' '.join(words)} [OPTIONS]`\n\n{description}\n\n{table(_HEADINGS, rows)}"


def _place(one: Parameter) -> str:
    return one.word if one.is_required else f"[{one.word.strip('[]')}]"


def _row(one: Parameter) -> tuple[str, ...]:
    default = "**required**" if one.is_required else _default(one)
    return _names(one), "" if one.is_argument else _value(one), default, one.info.help or ""


def _names(one: Parameter) -> str:
    if one.is_argument:
        return f"`{one.word if one.is_required else one.word.strip('[]')}`"
    return ", ".join(f"`{name}`" for name in _declared(one))


def _declared(one: Parameter) -> list[str]:
    """`--name`, `-n`, `--no-name` as the option was declared."""
    # In an Annotated the first name is where Typer's older form has the default.
    given = (one.info.default, *(one.info.param_decls or ()))
    names = [name for name in given if isinstance(name, str) and name.startswith("-")]
    return [part for name in names or [f"--{one.name}"] for part in name.split("/")]


def _value(one: Parameter) -> str:
    if one.kind is bool:
        return ""
    if get_origin(one.kind) is Literal:
        return ", ".join(f"`{choice}`" for choice in get_args(one.kind))
    low, high = one.info.min, one.info.max
    if low is not None and high is not None:
        return f"`{one.word}`, {low:g} to {high:g}"
    return f"`{one.word}`" if low is None else f"`{one.word}`, ≥ {low:g}"


def _default(one: Parameter) -> str:
    if one.kind is bool:  # a pair of names has one of them by default
        on, *off = [name for name in _declared(one) if name.startswith("--")]
        return f"`{on if one.default else off[0]}`" if off else ""
    return "" if one.default is None else f"`{one.default}`"
