"""Options that several commands share, and the scenario and the read options that they make."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ptnsbc_core.tasks.table import TaskName
from ptnsbc_tools.limits import LONGEST_S, SHORTEST_WINDOW_S

if TYPE_CHECKING:
    from ptnsbc_sim.scenario import Scenario
    from ptnsbc_tools.reading.bag_reader import ReadOptions


def scenario_names(incomplete: str) -> list[str]:
    """Names of scenarios for the completion of the shell; files are completed by the shell itself."""
    from ptnsbc_sim.scenario.reading.reader import available

    return [name for name in available() if name.startswith(incomplete)]


ScenarioArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="A scenario file, or a name such as paper_5.",
        autocompletion=scenario_names,
    ),
]
NamespaceOption = Annotated[
    str,
    typer.Option(
        "--namespace",
        metavar="NAME",
        help="Of all nodes and topics of the fleet, so that several fleets can share a domain.",
    ),
]
PlantOption = Annotated[
    Literal["quadrotor", "rigid_body_6dof"] | None, typer.Option("--plant", help="Vehicle model.")
]
TaskOption = Annotated[
    TaskName | None,
    typer.Option("--task", help="Formation task."),
]
ProfileOption = Annotated[
    Literal["paper", "soft", "reference"] | None,
    typer.Option("--profile", help="Gain profile of every loop that has no profile of its own."),
]
AvoidanceOption = Annotated[
    Literal["off", "set_based", "switched"] | None,
    typer.Option("--avoidance", help="How UAVs avoid obstacles and each other."),
]
SeedOption = Annotated[
    int | None,
    typer.Option(
        "--seed", metavar="N", min=0, help="Seed of all random disturbances: noise, gusts, losses."
    ),
]
DurationOption = Annotated[
    float | None, typer.Option("--duration", metavar="S", help="Length of the flight.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Any other key of the scenario, dotted, e.g. sensor.range_m=5. Repeatable.",
    ),
]


def full_namespace(given: str) -> str:
    """A namespace as ROS names it: `/blue` for `blue` and `/blue/`."""
    return given and f"/{given.strip('/')}"


BagOption = Annotated[
    Path | None, typer.Option("--bag", metavar="DIR", help="Record into this folder.")
]
AllowArmingOption = Annotated[
    bool, typer.Option("--allow-arming", help="Arm real vehicles and take off.")
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace an existing bag.")]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")
]
PlainOption = Annotated[
    bool, typer.Option("--plain", help="Lines instead of the table that redraws itself.")
]
FoxgloveOption = Annotated[
    int | None,
    typer.Option(
        "--foxglove",
        metavar="PORT",
        min=1,
        max=65535,
        help="Serve the live view to Foxglove on this port of this host, e.g. 8765 with the extra `foxglove`.",
    ),
]
BagArgument = Annotated[
    Path, typer.Argument(metavar="BAG", help="Folder of a bag, or its .mcap file.")
]
FlownOption = Annotated[
    Path | None,
    typer.Option("--scenario", metavar="FILE", help="Use this file and not the attached scenario."),
]
ToleranceOption = Annotated[
    float | None,
    typer.Option(
        "--tolerance",
        metavar="M",
        min=1e-6,
        help="Limit of the formation error at the deadline. Default: that of the scenario.",
    ),
]
WindowOption = Annotated[
    float | None,
    typer.Option(
        "--window",
        metavar="S",
        min=SHORTEST_WINDOW_S,
        max=LONGEST_S,
        help="Judge only the first S seconds of each leg.",
    ),
]
OdomOption = Annotated[
    str, typer.Option("--odom", metavar="TOPIC", help="Odometry; {n} is the id of the UAV.")
]
WrenchOption = Annotated[
    str, typer.Option("--wrench", metavar="TOPIC", help="WrenchStamped, where it is recorded.")
]
EpochOption = Annotated[
    float | None,
    typer.Option(
        "--epoch",
        metavar="S",
        min=0.0,
        max=LONGEST_S,
        help="Epoch in seconds after the start, for a bag that has none.",
    ),
]
SWEEPS = Path("out") / "sweeps"  # each sweep has a folder of its name here, unless -o says where
LAST_DOMAIN = 232  # of the middleware: a fleet that flies may be in any
HIGHEST_DOMAIN = 101  # above it the ports overlap those that the system assigns to programs
NetworkOption = Annotated[
    Path | None,
    typer.Option(
        "--network",
        metavar="PROFILE",
        help="Fly with other computers: a file that `ptnsbc network` wrote. Default: PTNSBC_NETWORK.",
    ),
]
DomainOption = Annotated[
    int | None,
    typer.Option(
        "--domain",
        metavar="N",
        min=0,
        max=HIGHEST_DOMAIN,
        help="ROS domain, the same on all computers of a fleet. Default: ROS_DOMAIN_ID.",
    ),
]
FlyingDomainOption = Annotated[
    int | None,
    typer.Option(
        "--domain",
        metavar="N",
        min=0,
        max=LAST_DOMAIN,
        help="ROS domain that the fleet printed. Default: ROS_DOMAIN_ID.",
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
"""Options that set a key of the scenario file."""


MissionOption = Annotated[
    Path | None,
    typer.Option(
        "--mission",
        metavar="FILE",
        help="Fly these legs: a YAML file with what stands below `mission` in a scenario.",
    ),
]
ParamsFileOption = Annotated[
    Path | None,
    typer.Option(
        "--params-file",
        metavar="FILE",
        help="Values from a ROS parameter file, as `ptnsbc params` and `ros2 param dump` write one; other options win.",
    ),
]


def overrides(**options: Any) -> dict[str, Any]:
    """Dotted keys of the scenario file from options by the name of their variable; ignores other options."""
    given = {key: options.get(name) for name, key in _KEYS.items()}
    if options.get("mission") is not None:
        given["mission"] = _mission(options["mission"])
    given |= dict(_setting(text) for text in options.get("settings") or ())
    return {key: value for key, value in given.items() if value is not None}


def chosen(context: typer.Context) -> Scenario:
    """The scenario that the arguments and options of a command make."""
    name, given = context.params["scenario"], overrides(**context.params)
    file = context.params.get("params_file")
    with _named(context.params.get("mission")):
        return scenario_with(name, given) if file is None else _with_parameters(name, file, given)


@contextmanager
def _named(mission: Path | None) -> Iterator[None]:
    """Errors of legs name the file that they are in, not the scenario that flies them."""
    from ptnsbc_sim.scenario import ScenarioError

    try:
        yield
    except ScenarioError as error:
        _, found, rest = str(error).partition(": mission.")
        if mission is None or not found:
            raise
        raise ScenarioError(f"{mission}: mission.{rest}") from None


def _with_parameters(name: str, file: Path, given: dict[str, Any]) -> Scenario:
    """A scenario with the values of a ROS parameter file, and with other options, which win."""
    from ptnsbc_nodes.runtime.scenario_parameters import given_parameters
    from ptnsbc_sim.scenario import ScenarioError, load_scenario, scenario_from_text
    from ptnsbc_sim.scenario.reading.reader import read_text

    scenario, parameters = load_scenario(name), given_parameters(read_text(file), str(file))
    if parameters.text:
        other = scenario_from_text(parameters.text, parameters.values, source=str(file))
        if other.name != scenario.name:
            raise ScenarioError(
                f"{file}: holds the scenario {other.name}: expected the values of {scenario.name}, or "
                f"{other.name} to be flown"
            )
        return other.with_(given)
    return scenario.with_(parameters.values).with_(given)


def _mission(path: Path) -> Any:
    """The mission of a file: the whole of it, or what stands below `mission`."""
    from ptnsbc_sim.scenario import ScenarioError
    from ptnsbc_sim.scenario.reading.reader import parse, read_text

    tree = parse(read_text(path), str(path), begins="legs")
    found = tree.get("mission", tree)
    if not isinstance(found, dict) or "legs" not in found:
        raise ScenarioError(
            f"{path}: no legs: expected the key legs, or mission with legs below it"
        )
    return found


def _setting(text: str) -> tuple[str, Any]:
    from ptnsbc_sim.scenario.reading.reader import parse

    key, found, value = text.partition("=")
    if not found or not key.strip():
        raise typer.BadParameter(f'--set "{text}": expected KEY=VALUE')
    # Read like the file, so that numbers, lists and "5 s" mean the same.
    return key.strip(), parse(f"value: {value}", f"--set {key.strip()}")["value"]


def scenario_with(name: str, given: dict[str, Any]) -> Scenario:
    """A scenario with some of its keys replaced."""
    # Imported here: it loads numba, which `--help` does not need.
    from ptnsbc_sim.scenario import load_scenario

    return load_scenario(name, given)


def read_options(context: typer.Context) -> ReadOptions:
    """The options with which a bag is read and judged, from the options of a command."""
    from ptnsbc_tools.reading.bag_reader import ReadOptions
    from ptnsbc_tools.reading.bag_sources import TopicNames

    given = context.params
    return ReadOptions(
        scenario=given["scenario"],
        tolerance=given["tolerance"],
        window_s=given["window"],
        epoch_s=given["epoch"],
        names=TopicNames(odom=given["odom"], wrench=given["wrench"]),
    )
