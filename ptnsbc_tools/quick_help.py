"""The help of a command without the parsing of any option: what parses them takes longer to load than all the rest."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

_MARKDOWN = "rich.markdown"
_END_OF_OPTIONS = "--"


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


def spare_markdown() -> None:
    """Load what formats help without a parser of Markdown, a third of its CPU: our help is no Markdown."""
    if _MARKDOWN not in sys.modules:
        empty = ModuleType(_MARKDOWN)
        vars(empty)["Markdown"] = type("Markdown", (), {})
        sys.modules[_MARKDOWN] = empty
        try:
            import_module("typer.rich_utils")  # looks for the class once
        finally:
            del sys.modules[_MARKDOWN]


def _context(command: Any, name: str | None, parent: Any) -> Any:
    return command.context_class(command, info_name=name, parent=parent, **command.context_settings)
