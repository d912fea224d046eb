"""The command line `ptnsbc`. Exit codes: 0 done, 1 deadline not met, 2 refused, 130 interrupted."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.signals import exit_on_signal, keep_exit_code, restore_handlers
from ptnsbc_tools import console
from ptnsbc_tools.commands import bag, network
from ptnsbc_tools.commands.autopilot import autopilot
from ptnsbc_tools.commands.bridge import bridge
from ptnsbc_tools.commands.check import check
from ptnsbc_tools.commands.compare import compare
from ptnsbc_tools.commands.demo import demo
from ptnsbc_tools.commands.doctor import doctor
from ptnsbc_tools.commands.fleet import fleet
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
from ptnsbc_tools.commands.verify import verify

_REFUSED, _INTERRUPTED = 2, 130
_STARTS_PROCESSES = ("fleet", "demo", "node")


class _Commands(TyperGroup):
    """Prints our errors as one line on stderr, and an interrupt without a traceback."""

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
    add_completion=False,
    pretty_exceptions_enable=False,
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


app.command()(new)
app.command()(scenarios)
app.command()(doctor)
app.command()(check)
app.command()(simulate)
app.command()(sweep)
app.command()(compare)
app.command()(verify)
app.command()(fleet)
app.command()(demo)
app.command()(report)
app.command()(plot)
app.command()(reproduce)
app.command()(autopilot)
app.command()(record)
app.command()(params)
app.command()(bridge)
app.command(context_settings=SETTINGS)(node)
app.command()(stop)
app.command()(key)
app.command()(replay)
app.add_typer(bag.app, name="bag")
app.add_typer(network.app, name="network")


def main() -> None:
    """Run the command line; `ptnsbc_tools.__main__` is the entry point."""
    exit_on_signal(_INTERRUPTED, "interrupted")
    app(prog_name="ptnsbc")


if __name__ == "__main__":
    main()
