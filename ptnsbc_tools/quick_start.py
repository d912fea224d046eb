"""Imports that a command can do without: parsers of options for a help, the compiler of the laws for a short bag."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

_UNUSED = {"rich.markdown": "Markdown", "rich.traceback": "Traceback"}
"""Modules that the formatter of help imports in vain: no text of our help is Markdown, no error has a traceback."""

_END_OF_OPTIONS = "--"
_HELP = ("-h", "--help")
_COMPLETION = "_PTNSBC_COMPLETE"
"""A shell that completes a line names it here, and gives no words."""
_LAWS = "ptnsbc_core.kernel"
_COMPILED_FROM = 64_000_000
"""Bytes of a bag. The judgement of one takes few laws; that of a shorter bag is done before numba has been loaded."""


def help_asked(group: Any, name: str | None, words: list[str]) -> Any:
    """The context of the command whose help these words ask for; None where they do not, or ask the group itself."""
    command, context = group, _context(group, name, None)
    rest = list(words)
    while rest and rest[0] in getattr(command, "commands", {}):
        command = command.commands[rest[0]]
        context = _context(command, rest.pop(0), context)
    own = rest[: rest.index(_END_OF_OPTIONS)] if _END_OF_OPTIONS in rest else rest
    # `ptnsbc node uav --help` asks the process and not the command.
    asks_another = context.ignore_unknown_options and own[:1] not in (["-h"], ["--help"])
    if command is group or asks_another or set(context.help_option_names).isdisjoint(own):
        return None
    return context


def keep_only(app: Any, words: list[str]) -> None:
    """Drop what these words do not need: Typer reads the options of every command it has.

    Of a command that they name the others go; of a help of all commands the options of each.
    """
    commands = {_name(one.name, one.callback): one for one in app.registered_commands}
    groups = {one.name: one for one in app.registered_groups}
    if words and (words[0] in commands or words[0] in groups):
        app.registered_commands = [commands[words[0]]] if words[0] in commands else []
        app.registered_groups = [groups[words[0]]] if words[0] in groups else []
    elif (not words or words[0] in _HELP) and _COMPLETION not in os.environ:
        for command in commands.values():
            command.callback = _without_options(command.callback)
        for group in groups.values():
            group.typer_instance.registered_commands = []


def _without_options(command: Any) -> Any:
    def named() -> None:
        pass

    named.__name__, named.__doc__ = command.__name__, command.__doc__
    return named


def spare_unused() -> None:
    """Load what formats help without the libraries that our help does not use, half of its CPU."""
    missing = {name: kind for name, kind in _UNUSED.items() if name not in sys.modules}
    for name, kind in missing.items():
        empty = ModuleType(name)
        vars(empty)[kind] = type(kind, (), {})
        sys.modules[name] = empty
    try:
        import_module("typer.rich_utils")  # looks for the classes once
    finally:
        for name in missing:
            del sys.modules[name]


def spare_compiler(bag: Path) -> None:
    """Interpret the laws in this process, with the same results, unless they are loaded already or the bag is long."""
    files = bag.glob("*") if bag.is_dir() else (bag,)
    size = sum(file.stat().st_size for file in files if file.is_file())
    if _LAWS not in sys.modules and size < _COMPILED_FROM:
        os.environ.setdefault("PTNSBC_JIT", "0")


def _name(given: str | None, command: Any) -> str:
    return given or str(command.__name__)


def _context(command: Any, name: str | None, parent: Any) -> Any:
    return command.context_class(command, info_name=name, parent=parent, **command.context_settings)
