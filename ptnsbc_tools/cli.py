"""The command line `ptnsbc`. Exit codes: 0 done, 1 deadline not met, 2 refused, 130 interrupted."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperGroup

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.signals import exit_on_signal, restore_handlers
from ptnsbc_tools import options
from ptnsbc_tools.commands.autopilot import autopilot
from ptnsbc_tools.commands.bag import app as bags
from ptnsbc_tools.commands.bridge import bridge
from ptnsbc_tools.commands.network import app as network_app
from ptnsbc_tools.commands.node import SETTINGS, node
from ptnsbc_tools.commands.params import params
from ptnsbc_tools.commands.plot import plot
from ptnsbc_tools.commands.record import record
from ptnsbc_tools.commands.replay import replay
from ptnsbc_tools.commands.report import report
from ptnsbc_tools.commands.reproduce import reproduce
from ptnsbc_tools.commands.stop import stop

REFUSED, INTERRUPTED = 2, 130
_STARTS_PROCESSES = ("fleet", "demo", "node")


class _Commands(TyperGroup):
    """Errors of ours as one line on stderr, an interrupt without a traceback."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except PtnsbcError as error:
            line = " ".join(str(error).split())
            print(f"error: {line}", file=sys.stderr)
            raise typer.Exit(REFUSED) from None
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            raise typer.Exit(INTERRUPTED) from None

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


@app.command()
def check(
    context: typer.Context,
    scenario: options.ScenarioArgument,
    plant: options.PlantOption = None,
    task: options.TaskOption = None,
    profile: options.ProfileOption = None,
    avoidance: options.AvoidanceOption = None,
    duration: options.DurationOption = None,
    settings: options.SetOption = None,
    json: options.JsonOption = False,
) -> None:
    """Check a scenario before anything arms: graph, shape, spacing, gains, deadline, obstacles."""
    from ptnsbc_tools.commands import check

    check.run(options.chosen(context), json=json)


@app.command()
def simulate(
    context: typer.Context,
    scenario: options.ScenarioArgument,
    plant: options.PlantOption = None,
    task: options.TaskOption = None,
    profile: options.ProfileOption = None,
    avoidance: options.AvoidanceOption = None,
    seed: options.SeedOption = None,
    duration: options.DurationOption = None,
    settings: options.SetOption = None,
    bag: options.BagOption = None,
    overwrite: options.OverwriteOption = False,
    json: options.JsonOption = False,
) -> None:
    """Fly a scenario in this process, without ROS, as fast as it goes; ends with the verdict."""
    from ptnsbc_tools import result
    from ptnsbc_tools.commands import simulate as command

    chosen = options.chosen(context)
    result.leave(command.simulate(chosen, bag, overwrite=overwrite, json=json))


@app.command()
def verify(
    bag: options.BagArgument,
    scenario: options.FlownOption = None,
    tolerance: options.ToleranceOption = None,
    window: options.WindowOption = None,
    odom: options.OdomOption = options.ODOM,
    wrench: options.WrenchOption = options.WRENCH,
    epoch: options.EpochOption = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", metavar="PNG", help="Draw the flight as well.")
    ] = None,
    json: options.JsonOption = False,
) -> None:
    """Judge a recorded flight: deadline met, missed or void, input, energy and separations.

    An error counts from the epoch on, outside encounters: spans in which the UAV, or one it
    follows, keeps clear of something, and a recovery time of 1 s + 3/kappa after them. Settling is
    the last exit from the band of 2 % of the start error or the tolerance, whichever is larger;
    only encounters that begin after the deadline excuse an exit. Each formation leg is judged. Bags
    of others (MCAP, sqlite3) need --scenario, and their topics named.
    """
    from ptnsbc_tools import result
    from ptnsbc_tools.commands import verify as command
    from ptnsbc_tools.reading.foreign import Names

    names = Names(odom=odom, wrench=wrench)
    choice = command.ReadOptions(scenario, tolerance, window, epoch, names)
    result.leave(command.verify(bag, choice, picture=picture, json=json))


@app.command()
def fleet(
    context: typer.Context,
    scenario: options.ScenarioArgument,
    lockstep: Annotated[
        bool,
        typer.Option(
            "--lockstep/--real-time",
            help="As fast as it goes and the same bytes every time, or by the wall clock.",
        ),
    ] = False,
    backend: Annotated[
        Literal["sim", "mavlink"],
        typer.Option("--backend", help="The simulator, or a MAVLink bridge per flight controller."),
    ] = "sim",
    allow_arming: options.AllowArmingOption = False,
    only: Annotated[
        str,
        typer.Option(
            "--only",
            metavar="PROCESSES",
            help="Start these on this computer, others elsewhere: recorder,sim,1,2. Who has the "
            "recorder waits for all, starts the flight and ends it.",
        ),
    ] = "",
    network: options.NetworkOption = None,
    domain: options.DomainOption = None,
    plant: options.PlantOption = None,
    task: options.TaskOption = None,
    profile: options.ProfileOption = None,
    avoidance: options.AvoidanceOption = None,
    seed: options.SeedOption = None,
    duration: options.DurationOption = None,
    settings: options.SetOption = None,
    bag: options.BagOption = None,
    overwrite: options.OverwriteOption = False,
    json: options.JsonOption = False,
) -> None:
    """Fly a scenario with one ROS 2 process per UAV; ends with the verdict.

    The vehicles are simulated, or real flight controllers (--backend mavlink). Nothing leaves this
    host unless --network says where to.
    """
    from ptnsbc_tools.commands import fleet as command

    options.join(network, domain)
    chosen = options.chosen(context)
    wishes = command.FleetRequest(
        lockstep=lockstep,
        backend=backend,
        allow_arming=allow_arming,
        bag=bag,
        overwrite=overwrite,
        json=json,
        only=only,
    )
    raise typer.Exit(command.fleet(chosen, wishes))


@app.command()
def demo(
    duration: options.DurationOption = None,
    folder: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for the bag and the picture.")
    ] = Path("out"),
    json: options.JsonOption = False,
) -> None:
    """Fly Simulation 1 of the paper with a fleet in lock-step: bag, verdict and picture."""
    from ptnsbc_tools.commands import fleet as command

    given = options.overrides(duration=duration)
    chosen = options.scenario_with(command.DEMO_SCENARIO, given)
    raise typer.Exit(command.fleet(chosen, command.demo_wishes(folder, json=json)))


app.command()(report)
app.command()(plot)
app.command()(reproduce)
app.command()(autopilot)
app.command()(record)
app.command()(params)
app.command()(bridge)
app.command(context_settings=SETTINGS)(node)
app.command()(stop)
app.command()(replay)
app.add_typer(bags, name="bag")
app.add_typer(network_app, name="network")


def main() -> None:
    """Run the command line; `ptnsbc_tools.__main__` is the entry point."""
    exit_on_signal(INTERRUPTED, "interrupted")
    app(prog_name="ptnsbc")


if __name__ == "__main__":
    main()
