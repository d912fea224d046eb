"""The whole command line, with every command loaded."""

from __future__ import annotations

from typing import Any

from typer.main import get_command

from ptnsbc_tools.cli import app


def every_command() -> Any:
    """The group of all commands, each of them loaded."""
    group: Any = get_command(app)
    for name in group.list_commands(None):
        group.get_command(None, name)
    return group
