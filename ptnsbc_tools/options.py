"""Options that several commands share, and the scenario they make."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

if TYPE_CHECKING:
    from ptnsbc_sim.scenario import Scenario

ScenarioArgument = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="A scenario file, or a name such as paper_5.")
]
PlantOption = Annotated[
    Literal["quadrotor", "rigid_body_6dof"] | None, typer.Option("--plant", help="Vehicle model.")
]
TaskOption = Annotated[
    Literal["distance_angles", "parent_angle", "relative_position"] | None,
    typer.Option("--task", help="Formation task."),
]
ProfileOption = Annotated[
    Literal["paper", "soft", "reference"] | None,
    typer.Option("--profile", help="Gain profile of every loop that does not set its own."),
]
AvoidanceOption = Annotated[
    Literal["off", "set_based", "switched"] | None,
    typer.Option("--avoidance", help="How obstacles and other UAVs are kept clear of."),
]
SeedOption = Annotated[
    int | None,
    typer.Option(
        "--seed", min=0, help="Of all that happens by chance: noise, gusts, lost messages."
    ),
]
DurationOption = Annotated[
    float | None, typer.Option("--duration", metavar="SECONDS", help="Length of the flight.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Any other key of the scenario, dotted, e.g. gains.formation.kappa_1_s=3. Repeatable.",
    ),
]
BagOption = Annotated[
    Path | None, typer.Option("--bag", metavar="DIR", help="Record into this folder.")
]
AllowArmingOption = Annotated[
    bool, typer.Option("--allow-arming", help="Arm real vehicles and take off.")
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace an existing bag.")]
JsonOption = Annotated[
    bool, typer.Option("--json", help="One JSON object on stdout and nothing else.")
]
BagArgument = Annotated[
    Path, typer.Argument(metavar="BAG", help="Folder of a bag, or its .mcap file.")
]
FlownOption = Annotated[
    Path | None,
    typer.Option("--scenario", metavar="FILE", help="Instead of the scenario in the bag."),
]
ToleranceOption = Annotated[
    float | None,
    typer.Option(
        "--tolerance",
        metavar="M",
        min=1e-6,
        help="Hard limit at the deadline; by default the scenario's.",
    ),
]
WindowOption = Annotated[
    float | None,
    typer.Option("--window", metavar="S", min=0.01, help="Judge so much of each leg, not all."),
]
OdomOption = Annotated[
    str, typer.Option("--odom", metavar="TOPIC", help="Odometry; {n} is the id of the UAV.")
]
WrenchOption = Annotated[
    str, typer.Option("--wrench", metavar="TOPIC", help="WrenchStamped, where it is recorded.")
]
EpochOption = Annotated[
    float | None,
    typer.Option("--epoch", metavar="S", min=0.0, help="Of a bag without: after its start."),
]
HIGHEST_DOMAIN = 101  # above, the ports reach into those that systems hand out
NetworkOption = Annotated[
    Path | None,
    typer.Option(
        "--network",
        metavar="PROFILE",
        help="Fly with other computers: a file from `ptnsbc network`; PTNSBC_NETWORK.",
    ),
]
DomainOption = Annotated[
    int | None,
    typer.Option(
        "--domain",
        min=0,
        max=HIGHEST_DOMAIN,
        help="ROS domain, the same on all computers of a fleet; ROS_DOMAIN_ID.",
    ),
]
ODOM, WRENCH = "/uav{n}/odom", "/uav{n}/setpoint/wrench"


_KEYS = {
    "plant": "plant.kind",
    "task": "formation.task",
    "profile": "gains.profile",
    "avoidance": "formation.avoidance",
    "seed": "seed",
    "duration": "timing.duration_s",
}
"""Options that stand for a key of the scenario file."""


def overrides(**options: Any) -> dict[str, Any]:
    """Dotted keys of the scenario file from options by the name of their variable; others are left alone."""
    given = {key: options.get(name) for name, key in _KEYS.items()}
    given |= dict(_setting(text) for text in options.get("settings") or ())
    return {key: value for key, value in given.items() if value is not None}


def chosen(context: typer.Context) -> Scenario:
    """The scenario that the arguments and options of a command make."""
    return scenario_with(context.params["scenario"], overrides(**context.params))


def join(network: Path | None, domain: int | None) -> None:
    """Put what the command line says of network and domain where ROS and our processes look for it."""
    from ptnsbc_nodes.runtime.environment import NETWORK

    if network is not None:
        os.environ[NETWORK] = str(network)
    if domain is not None:
        os.environ["ROS_DOMAIN_ID"] = str(domain)


def _setting(text: str) -> tuple[str, Any]:
    from ptnsbc_sim.scenario.reader import parse

    key, found, value = text.partition("=")
    if not found or not key.strip():
        raise typer.BadParameter(f'--set "{text}": expected KEY=VALUE')
    # Read as the file would be, so that numbers, lists and "5 s" mean the same.
    return key.strip(), parse(f"value: {value}", f"--set {key.strip()}")["value"]


def scenario_with(name: str, given: dict[str, Any]) -> Scenario:
    """The scenario of a command line."""
    # Here, not above: it loads numba, for which `--help` and an early Ctrl-C need not wait.
    from ptnsbc_sim.scenario import load_scenario

    return load_scenario(name, given)
