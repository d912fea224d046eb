"""The command line `ptnsbc`. Exit codes: 0 done, 1 deadline not met, 2 refused, 130 interrupted."""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.environment import one_thread
from ptnsbc_nodes.runtime.signals import exit_on_signal, keep_exit_code, restore_handlers
from ptnsbc_tools import console
from ptnsbc_tools.commands.bags import bag
from ptnsbc_tools.commands.bags.record import record
from ptnsbc_tools.commands.bags.replay import replay
from ptnsbc_tools.commands.begin.check import check
from ptnsbc_tools.commands.begin.doctor import doctor
from ptnsbc_tools.commands.begin.new import new, scenarios
from ptnsbc_tools.commands.fly import mission
from ptnsbc_tools.commands.fly.demo import demo
from ptnsbc_tools.commands.fly.fleet import fleet
from ptnsbc_tools.commands.fly.inject import inject
from ptnsbc_tools.commands.fly.simulate import simulate
from ptnsbc_tools.commands.fly.stop import stop
from ptnsbc_tools.commands.fly.sweep import sweep
from ptnsbc_tools.commands.fly.view import view
from ptnsbc_tools.commands.look.compare import compare
from ptnsbc_tools.commands.look.export import export
from ptnsbc_tools.commands.look.plot import plot
from ptnsbc_tools.commands.look.report import report
from ptnsbc_tools.commands.look.reproduce import SETTINGS as PAPER
from ptnsbc_tools.commands.look.reproduce import reproduce
from ptnsbc_tools.commands.look.verify import verify
from ptnsbc_tools.commands.processes import network, security
from ptnsbc_tools.commands.processes.autopilot import autopilot
from ptnsbc_tools.commands.processes.bridge import bridge
from ptnsbc_tools.commands.processes.key import key
from ptnsbc_tools.commands.processes.node import SETTINGS, node
from ptnsbc_tools.commands.processes.params import params
from ptnsbc_tools.commands.processes.tune import tune
from ptnsbc_tools.quick_start import help_asked, keep_only, spare_unused

_REFUSED, _INTERRUPTED = 2, 130
_REPLACED = {"--out": "--output", "--jobs": "--workers", "--key": "--signing-key"}
"""Options of earlier versions, and those of today."""
_STARTS_PROCESSES = ("fleet", "demo", "node", "view", "tune")


class _Commands(TyperGroup):
    """Prints our errors as one line on stderr, and an interrupt without a traceback."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        if not args or {"-h", "--help"} & set(args):
            spare_unused()
        asked = help_asked(self, info_name, args)
        if asked is None:
            return super().make_context(info_name, args, parent, **extra)
        print(asked.command.get_help(asked), end="")
        raise typer.Exit

    def invoke(self, ctx: Any) -> Any:
        code = 0
        try:
            return super().invoke(ctx)
        except typer.Exit as end:
            code = end.exit_code
            raise
        except PtnsbcError as error:
            line = " ".join(str(error).split())
            console.say(f"error: {line}")
            code = _REFUSED
            raise typer.Exit(_REFUSED) from None
        except Exception as error:
            option = getattr(error, "option_name", "")  # of Click's NoSuchOption
            if option not in _REPLACED:
                raise
            console.say(f"error: {option}: no such option: expected {_REPLACED[option]}")
            code = _REFUSED
            raise typer.Exit(_REFUSED) from None
        except KeyboardInterrupt:
            keep_exit_code(_INTERRUPTED)  # a second signal is no error
            print("interrupted", file=sys.stderr)
            code = _INTERRUPTED
            raise typer.Exit(_INTERRUPTED) from None
        finally:
            keep_exit_code(code)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        found = super().resolve_command(ctx, args)
        if found[0] not in _STARTS_PROCESSES:  # those have handlers of their own all the time
            restore_handlers()
        return found


app = typer.Typer(
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Predefined-time formations of UAVs: check, fly, record and judge.",
    epilog="Exit codes: 0 deadlines met, 1 a deadline not met, 2 refused, 130 interrupted.",
)


def _version(wanted: bool) -> None:
    if wanted:
        from ptnsbc_nodes.runtime.provenance import own_version

        print(f"ptnsbc {own_version()}")
        raise typer.Exit


@app.callback()
def _main(
    show_version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    pass


_PANELS = {
    "begin": "Begin",
    "fly": "Fly",
    "look": "Look at flights",
    "bags": "Bags",
    "processes": "Processes, vehicles, networks",
}
"""The panel of the help for each folder of `ptnsbc_tools.commands`."""

_COMMANDS: tuple[Callable[..., None], ...] = (
    *(new, scenarios, doctor, check),
    *(simulate, sweep, fleet, view, demo, inject, stop),
    *(verify, compare, report, plot, export),
    *(record, replay),
    *(autopilot, bridge, tune, params, key),
)


def _panel(module: str) -> str:
    return _PANELS[module.split(".")[2]]


def _paragraphs(command: Callable[..., None]) -> str:
    """The docstring of a command, each paragraph in one line: the terminal wraps it, wherever the source does."""
    text = inspect.cleandoc(command.__doc__ or "")
    return "\n\n".join(" ".join(one.split()) for one in text.split("\n\n"))


for _command in _COMMANDS:
    _help = _paragraphs(_command)
    app.command(help=_help, rich_help_panel=_panel(_command.__module__))(_command)
# All words after the name of a process are its own, --help too.
app.command(rich_help_panel=_panel(node.__module__), context_settings=SETTINGS)(node)
app.command(rich_help_panel=_panel(reproduce.__module__), context_settings=PAPER)(reproduce)
for _group in (mission, bag, network, security):
    _name = _group.__name__.rsplit(".", 1)[1]
    app.add_typer(_group.app, name=_name, rich_help_panel=_panel(_group.__name__))


def main() -> None:
    """Run the command line; `ptnsbc_tools.__main__` is the entry point."""
    exit_on_signal(_INTERRUPTED, "interrupted")
    one_thread(os.environ)
    keep_only(app, sys.argv[1:])
    app(prog_name="ptnsbc")


if __name__ == "__main__":
    main()
