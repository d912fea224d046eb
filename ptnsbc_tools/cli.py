"""The command line `ptnsbc`. Exit codes: 0 done, 1 deadline not met, 2 refused, 130 interrupted."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.signals import exit_on_signal, keep_exit_code, restore_handlers
from ptnsbc_tools import console
from ptnsbc_tools.commands import bag, mission, network
from ptnsbc_tools.commands.autopilot import autopilot
from ptnsbc_tools.commands.bridge import bridge
from ptnsbc_tools.commands.check import check
from ptnsbc_tools.commands.compare import compare
from ptnsbc_tools.commands.demo import demo
from ptnsbc_tools.commands.doctor import doctor
from ptnsbc_tools.commands.export import export
from ptnsbc_tools.commands.fleet import fleet
from ptnsbc_tools.commands.inject import inject
from ptnsbc_tools.commands.key import key
from ptnsbc_tools.commands.new import new, scenarios
from ptnsbc_tools.commands.node import SETTINGS, node
from ptnsbc_tools.commands.params import params
from ptnsbc_tools.commands.plot import plot
from ptnsbc_tools.commands.record import record
from ptnsbc_tools.commands.replay import replay
from ptnsbc_tools.commands.report import report
from ptnsbc_tools.commands.reproduce import reproduce
from ptnsbc_tools.commands.simulate import simulate
from ptnsbc_tools.commands.stop import stop
from ptnsbc_tools.commands.sweep import sweep
from ptnsbc_tools.commands.tune import tune
from ptnsbc_tools.commands.verify import verify
from ptnsbc_tools.commands.view import view
from ptnsbc_tools.quick_help import help_asked, spare_markdown

_REFUSED, _INTERRUPTED = 2, 130
_STARTS_PROCESSES = ("fleet", "demo", "node", "view", "tune")


class _Commands(TyperGroup):
    """Prints our errors as one line on stderr, and an interrupt without a traceback."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        if not args or {"-h", "--help"} & set(args):
            spare_markdown()
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


_BEGIN, _FLY, _LOOK = "Begin", "Fly", "Look at flights"
_BAGS, _PROCESSES = "Bags", "Processes, vehicles, networks"

_GROUPS: dict[str, tuple[Callable[..., None], ...]] = {
    _BEGIN: (new, scenarios, doctor, check),
    _FLY: (simulate, sweep, fleet, view, demo, inject, stop),
    _LOOK: (verify, compare, report, plot, export, reproduce),
    _BAGS: (record, replay),
    _PROCESSES: (autopilot, bridge, tune, params, key),
}
for _panel, _commands in _GROUPS.items():
    for _command in _commands:
        app.command(rich_help_panel=_panel)(_command)
# All words after the name of a process are its own, --help too.
app.command(rich_help_panel=_PROCESSES, context_settings=SETTINGS)(node)
app.add_typer(mission.app, name="mission", rich_help_panel=_FLY)
app.add_typer(bag.app, name="bag", rich_help_panel=_BAGS)
app.add_typer(network.app, name="network", rich_help_panel=_PROCESSES)


def main() -> None:
    """Run the command line; `ptnsbc_tools.__main__` is the entry point."""
    exit_on_signal(_INTERRUPTED, "interrupted")
    app(prog_name="ptnsbc")


if __name__ == "__main__":
    main()
