"""`ptnsbc reproduce`: the command of a clone, whose folder `paper/` has the experiments."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import typer

from ptnsbc_core.errors import PtnsbcError

CLONE = Path(__file__).resolve().parents[3]
SETTINGS = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}


class NoCloneError(PtnsbcError):
    """The packages are installed without the repository."""


def reproduce(context: typer.Context) -> None:
    """Fly the paper again: its figures, the baselines, our ablations, and a verdict on each claim.

    All words are those of `paper/`, `--help` too.
    """
    if not (CLONE / "paper" / "command.py").is_file():
        raise NoCloneError(
            f"{CLONE}/paper: there is no such folder: expected a clone of the repository; "
            "run ptnsbc reproduce from its .venv (make setup)"
        )
    sys.path.insert(0, str(CLONE))
    import_module("paper.command").app(
        context.args, prog_name="ptnsbc reproduce", standalone_mode=False
    )
