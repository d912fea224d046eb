"""The command line `ptnsbc`. Exit codes: 0 done, 1 deadline not met, 2 refused, 130 interrupted."""

from __future__ import annotations

import inspect
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.environment import one_thread
from ptnsbc_nodes.runtime.signals import exit_on_signal, keep_exit_code, restore_handlers
from ptnsbc_sim.plugins import NAMED, USER_CODE
from ptnsbc_tools import console
from ptnsbc_tools.options import flat, group

_REFUSED, _INTERRUPTED = 2, 130
_REPLACED = {
    "--out": "--output",
    "--jobs": "--workers",
    "--key": "--signing-key",
    "--deadline": "--set gains.formation.deadline_s=S",
}
"""Options that are expected by another name, or were named so in earlier versions."""
_STARTS_PROCESSES = ("fleet", "demo", "network", "view")
# All words after `reproduce` are of paper/, --help too.
_FOREIGN = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}

PANELS = {
    "Begin": "check:new check:check check:scenarios check:doctor",
    "Fly": "simulate:simulate simulate:sweep fleet:fleet fleet:demo",
    "A flying fleet": "flying_fleet:view flying_fleet:mission flying_fleet:stop",
    "Look at flights": "look:report look:verify simulate:compare look:plot look:export bags:bag look:reproduce",
    "Vehicles and networks": "vehicles:bridge vehicles:autopilot network:network",
}
"""The panels of `help all`: module of `ptnsbc_tools.commands`, and name in it, of each command or group of commands."""

_DAILY = ("new", "check", "simulate", "sweep", "fleet", "view", "report", "stop")
_PLACES = {
    place.rpartition(":")[2]: place for places in PANELS.values() for place in places.split()
}


def _load(name: str) -> Any:
    """The function of a command, or the Typer of a group of commands."""
    module, _, attribute = _PLACES[name].partition(":")
    return getattr(import_module(f"ptnsbc_tools.commands.{module}"), attribute)


def _help(function: Callable[..., Any]) -> str:
    """The docstring of a command, each paragraph in one line: the terminal wraps it."""
    paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def functions(names: Iterable[str] = _PLACES) -> Iterator[tuple[str, Callable[..., Any]]]:
    """These commands, those of groups by both names, and the function of each with all its options."""
    for name in names:
        loaded = _load(name)
        if not isinstance(loaded, typer.Typer):
            yield name, flat(loaded)
            continue
        for inner in loaded.registered_commands:
            if inner.callback is not None and not inner.hidden:
                yield f"{name} {inner.name or inner.callback.__name__}", inner.callback


class _Commands(TyperGroup):
    """Loads the module of a command with its first use, and prints our errors as one line on stderr."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(_PLACES)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in self.commands and cmd_name in _PLACES:
            loaded = _load(cmd_name)
            if not isinstance(loaded, typer.Typer):
                foreign = _FOREIGN if cmd_name == "reproduce" else None
                function, loaded = loaded, group("")
                loaded.command(help=_help(function), context_settings=foreign)(flat(function))
            self.commands[cmd_name] = command = get_command(loaded)
            command.name = cmd_name
        return super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        every = {
            panel: [place.rpartition(":")[2] for place in places.split()]
            for panel, places in PANELS.items()
        }
        shown = every if ctx.obj == "all" else {"The commands of a day": [*_DAILY]}
        for panel, names in shown.items():
            rows = [(path, _help(of).partition("\n")[0]) for path, of in functions(names)]
            with formatter.section(panel):
                formatter.write_dl(rows)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args[0] == "help" and not ctx.resilient_parsing:
            ctx.obj = " ".join(args[1:])
            if ctx.obj in ("", "all"):
                print(ctx.get_help())
                ctx.exit()
            args = [*args[1:], "--help"]
        if args[0] not in _PLACES:  # Typer suggests the nearest of those that are loaded
            for name in _PLACES:
                self.get_command(ctx, name)
        resolved = super().resolve_command(ctx, args)
        if resolved[0] not in _STARTS_PROCESSES:  # those have handlers of their own all the time
            restore_handlers()
        return resolved

    def invoke(self, ctx: Any) -> Any:
        code = 0
        os.environ[USER_CODE] = NAMED
        try:
            return super().invoke(ctx)
        except typer.Exit as end:
            code = end.exit_code
            raise
        except KeyboardInterrupt:
            keep_exit_code(_INTERRUPTED)  # a second signal is no error
            print("interrupted", file=sys.stderr)
            code = _INTERRUPTED
            raise typer.Exit(_INTERRUPTED) from None
        except Exception as error:
            line = _one_line(error)
            if line is None:
                raise
            console.say(f"error: {line}")
            code = _REFUSED
            raise typer.Exit(_REFUSED) from None
        finally:
            os.environ.pop(USER_CODE, None)
            keep_exit_code(code)


def _one_line(error: Exception) -> str | None:
    """The line that tells an error of ours, of a file, or of an option that has another name now; else None."""
    if isinstance(error, PtnsbcError):
        return " ".join(str(error).split())
    if (
        isinstance(error, OSError) and error.filename is not None
    ):  # too long a name, no right, a full disk
        return f"{error.filename}: {error.strerror}"
    name = getattr(error, "option_name", "")  # of Click's NoSuchOption
    return f"{name}: no such option: expected {_REPLACED[name]}" if name in _REPLACED else None


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # Rich and what it formats help with are half of the start-up
    context_settings={
        "help_option_names": ["-h", "--help"],
        "max_content_width": 200,
        # Typer's own default is no bool, and Typer loads Pydantic to make it one.
        "default_map": {"install_completion": False, "show_completion": False, "help": False},
    },
    help="UAVs in formation by a deadline: check, fly, record and judge.",
    epilog="Begin with `ptnsbc demo`. Every command: `ptnsbc help all`.\n\n"
    "Exit codes: 0 deadlines met, 1 not met, 2 refused, 130 interrupted.",
)


def _version(wanted: bool) -> None:
    if wanted:
        from ptnsbc_nodes.runtime.provenance import own_version

        print(f"ptnsbc {own_version()}")
        raise typer.Exit


@app.callback()
def _main(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line; `ptnsbc_tools.__main__` is the entry point."""
    exit_on_signal(_INTERRUPTED, "interrupted")
    one_thread(os.environ)
    try:
        app(prog_name="ptnsbc")
    except SystemExit as end:
        # `compiler` names the thread of a law so, and Python would wait for it.
        compiles = any(thread.name.startswith("compiler") for thread in threading.enumerate())
        if end.code == _INTERRUPTED and compiles:
            sys.stdout.flush()
            os._exit(_INTERRUPTED)
        raise


if __name__ == "__main__":
    main()
