"""Arguments and options that several commands share, and groups of options with what they make."""

from __future__ import annotations

import inspect
import math
import os
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

import typer
from typer.core import TyperGroup

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.tasks.table import TaskName
from ptnsbc_sim.plugins import REFUSED, USER_CODE
from ptnsbc_tools.limits import FARTHEST_M, FINEST_M, LONGEST_S, SHORTEST_WINDOW_S, refuse_outside

if TYPE_CHECKING:
    from ptnsbc_sim.scenario import Scenario

SWEEPS = Path("out") / "sweeps"  # each sweep has a folder of its name here, unless -o says where
LAST_DOMAIN = 232  # of the middleware: a fleet that flies may be in any
HIGHEST_DOMAIN = 101  # above it the ports overlap those that the system assigns to programs
UAV = "{n}"  # in names of topics: stands for the id of the UAV


def option(
    words: str, meaning: str, least: float | None = None, most: float | None = None, **more: Any
) -> Any:
    """An option as its help shows it: its names, then the word for its value, as in `--output -o DIR`."""
    parts = words.split(" ")
    names = [part for part in parts if part.startswith("-")]
    value = " ".join(parts[len(names) :]) or None
    return typer.Option(*names, metavar=value, help=meaning, min=least, max=most, **more)


def argument(word: str, meaning: str, **more: Any) -> Any:
    """An argument: the word that stands for it, and its meaning."""
    return typer.Argument(metavar=word, help=meaning, **more)


class Group(TyperGroup):
    """Commands whose list has the first paragraph of the help of each, whole."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of the commands."""
        rows = [
            (name, " ".join((command.help or "").partition("\n\n")[0].split()))
            for name, command in self.commands.items()
            if not command.hidden
        ]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def group(meaning: str) -> typer.Typer:
    """Several commands below one name."""
    return typer.Typer(
        cls=Group, no_args_is_help=True, add_completion=False, rich_markup_mode=None, help=meaning
    )


def flat(command: Callable[..., None]) -> Callable[..., None]:
    """A command in which each field of a parameter that is a dataclass is an option of its own."""
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {}
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        kind = hints[name]
        if not is_dataclass(kind):
            parameters.append(_keyword(name, kind, parameter.default))
            continue
        groups[name] = kind
        kinds = get_type_hints(kind, include_extras=True)
        for field in fields(kind):
            default = inspect.Parameter.empty if field.default is MISSING else field.default
            parameters.append(_keyword(field.name, kinds[field.name], default))

    @wraps(command)
    def run(**values: Any) -> None:
        for name, kind in groups.items():
            values[name] = kind(**{field.name: values.pop(field.name) for field in fields(kind)})
        command(**values)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in parameters}
    return run


def _keyword(name: str, kind: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=kind, default=default)


def scenario_names(incomplete: str) -> list[str]:
    """Names of scenarios for the completion of the shell; files are completed by the shell itself."""
    from ptnsbc_sim.scenario.reading.reader import available

    return [name for name in available() if name.startswith(incomplete)]


def refuse_code() -> None:
    """Let neither this command nor its processes run a file that a scenario names."""
    os.environ[USER_CODE] = REFUSED


def full_namespace(given: str) -> str:
    """A namespace as ROS names it: `/blue` for `blue` and `/blue/`."""
    return given and f"/{given.strip('/')}"


def _number_or_text(word: str) -> float | str:
    """A value of a scenario: a number, or a text such as "5 s", which the scenario understands or refuses."""
    try:
        return float(word)
    except ValueError:
        return word


ScenarioArgument = Annotated[
    str,
    argument(
        "SCENARIO", "A scenario file, or a name such as paper_5.", autocompletion=scenario_names
    ),
]
SetOption = Annotated[
    list[str] | None,
    option(
        "--set KEY=VALUE",
        "Any other key of the scenario, dotted, e.g. sensor.range_m=5. Repeatable.",
    ),
]
DurationOption = Annotated[
    float | None, option("--duration S", "Length of the flight.", parser=_number_or_text)
]
BagArgument = Annotated[Path, argument("BAG", "Folder of a bag, or its .mcap file.")]
BagOption = Annotated[Path | None, option("--bag DIR", "Record into this folder.")]
PictureOption = Annotated[
    Path | None, option("--picture FILE", "Draw the flight as a PNG, SVG or PDF.")
]
OverwriteOption = Annotated[bool, option("--overwrite", "Replace an existing bag.")]
JsonOption = Annotated[bool, option("--json", "Print one JSON object on stdout and nothing else.")]
StrictOption = Annotated[
    bool, option("--strict", "Count UAVs that gave way and came late as missed.")
]
VerboseOption = Annotated[bool, option("--verbose -v", "Print everything.")]
PlainOption = Annotated[bool, option("--plain", "Lines instead of the table that redraws itself.")]
AllowArmingOption = Annotated[bool, option("--allow-arming", "Arm real vehicles and take off.")]
NamespaceOption = Annotated[
    str,
    option(
        "--namespace NAME",
        "Of all nodes and topics of the fleet, so that several fleets can share a domain.",
        callback=full_namespace,
    ),
]
DomainOption = Annotated[
    int | None,
    option(
        "--domain N",
        "ROS domain, the same on all computers of a fleet. Default: ROS_DOMAIN_ID.",
        0,
        HIGHEST_DOMAIN,
    ),
]
FlyingDomainOption = Annotated[
    int | None,
    option(
        "--domain N",
        "ROS domain that the fleet printed. Default: ROS_DOMAIN_ID, or that of the only fleet of this host.",
        0,
        LAST_DOMAIN,
    ),
]

_KEYS = {
    "plant": "plant.kind",
    "task": "formation.task",
    "profile": "gains.profile",
    "avoidance": "formation.avoidance",
    "seed": "seed",
    "duration": "timing.duration_s",
}
"""Options that set a key of the scenario file."""
_SLOW: dict[str, float] = {"timing.control_hz": 50, "sensor.rate_hz": 10}
_ON_TICK = 1e-9  # of a tick


@dataclass(frozen=True)
class Choices:
    """Keys of a scenario that have options of their own, and `--set` for all others."""

    plant: Annotated[
        Literal["quadrotor", "rigid_body_6dof"] | None, option("--plant", "Vehicle model.")
    ] = None
    task: Annotated[TaskName | None, option("--task", "Formation task.")] = None
    profile: Annotated[
        Literal["paper", "soft", "reference"] | None,
        option("--profile", "Gain profile of every loop that has no profile of its own."),
    ] = None
    avoidance: Annotated[
        Literal["off", "set_based", "switched"] | None,
        option("--avoidance", "How UAVs avoid obstacles and each other."),
    ] = None
    settings: SetOption = None
    code: Annotated[
        bool, option("--code/--no-code", "Run the Python files that the scenario names.")
    ] = True

    def __post_init__(self) -> None:
        if not self.code:
            refuse_code()

    def keys(self) -> dict[str, Any]:
        """Dotted keys of the scenario file and their values."""
        from ptnsbc_sim.scenario.reading.reader import set_keys

        given = {_KEYS[name]: value for name, value in vars(self).items() if name in _KEYS}
        given["mission"] = _legs_in(getattr(self, "mission", None))
        given |= set_keys(self.settings or ())
        return {key: value for key, value in given.items() if value is not None}


@dataclass(frozen=True)
class FlightChoices(Choices):
    """The same of one flight: its random numbers, its length and its legs too."""

    seed: Annotated[
        int | None, option("--seed N", "Seed of all random disturbances: noise, gusts, losses.", 0)
    ] = None
    duration: DurationOption = None
    mission: Annotated[
        Path | None,
        option(
            "--mission FILE",
            "Fly these legs: a YAML file with what stands below `mission` in a scenario.",
        ),
    ] = None
    slow: Annotated[
        bool, option("--slow", "For a slow computer: control at 50 Hz, and sensors that fit it.")
    ] = False

    def of(self, scenario: str) -> Scenario:
        """The scenario of this name or file with these choices."""
        from ptnsbc_sim.scenario import ScenarioError

        try:
            return self.paced(scenario_with(scenario, self.keys()))
        except ScenarioError as error:
            # Errors of legs name the file that they are in, not the scenario that flies them.
            _, in_legs, rest = str(error).partition(": mission.")
            if self.mission is None or not in_legs:
                raise
            raise ScenarioError(f"{self.mission}: mission.{rest}") from None

    def paced(self, scenario: Scenario) -> Scenario:
        """The scenario, for a slow computer with rates and latencies that fit its control period."""
        fixes, keys = scenario.sensor.positioning, dict(_SLOW)
        if fixes is not None:
            ticks = math.floor(fixes.latency_s * _SLOW["timing.control_hz"] + _ON_TICK)
            keys["sensor.positioning.latency_s"] = ticks / _SLOW["timing.control_hz"]
        return scenario.with_(keys) if self.slow else scenario


class TopicPatternError(PtnsbcError):
    """A pattern without the id of the UAV."""


@dataclass(frozen=True)
class ReadOptions:
    """Options of reading and judging a bag.

    Raises:
        LimitError: a time that no bag reaches, or a tolerance that is none.
        TopicPatternError: a name of topics without {n}.
    """

    scenario: Annotated[
        Path | None, option("--scenario FILE", "Use this file and not the attached scenario.")
    ] = None
    tolerance_m: Annotated[
        float | None,
        option(
            "--tolerance M",
            "Limit of the formation error at the deadline. Default: that of the scenario.",
            FINEST_M,
            FARTHEST_M,
        ),
    ] = None
    window_s: Annotated[
        float | None,
        option(
            "--window S",
            "Judge only the first S seconds of each leg.",
            SHORTEST_WINDOW_S,
            LONGEST_S,
        ),
    ] = None
    odom: Annotated[str, option("--odom TOPIC", "States; {n} is the id of the UAV.")] = (
        "/uav{n}/odom"
    )
    wrench: Annotated[str, option("--wrench TOPIC", "WrenchStamped, where it is recorded.")] = (
        "/uav{n}/setpoint/wrench"
    )
    mapped: Annotated[
        list[str] | None,
        option(
            "--map N=TOPIC,...",
            "States of UAV N; behind a colon its frame: 1=/cf231/pose,2=/tf:cf232.",
        ),
    ] = None
    frame: Annotated[
        Literal["enu", "ned"], option("--frame", "Of the states; px4_msgs always ned.")
    ] = "enu"
    origins: Annotated[
        list[str] | None,
        option("--origin N=PLACE", "Zero of its states: x,y,z [m], or 47.3977N,8.5456E,488."),
    ] = None
    epoch_s: Annotated[
        float | None,
        option(
            "--epoch S",
            "Epoch in seconds after the start, for a bag that has none.",
            0.0,
            LONGEST_S,
        ),
    ] = None

    def __post_init__(self) -> None:
        refuse_outside("tolerance_m", self.tolerance_m, FINEST_M, FARTHEST_M)
        refuse_outside("window_s", self.window_s, SHORTEST_WINDOW_S)
        refuse_outside("epoch_s", self.epoch_s)
        for name in ("odom", "wrench"):
            pattern = getattr(self, name)
            if UAV not in pattern:
                raise TopicPatternError(
                    f"{name}: {pattern!r}: expected {UAV} for the id of the UAV, like /drone{UAV}/odom"
                )


AS_RECORDED = ReadOptions()
"""Of a bag of ours, judged as its scenario says."""


@dataclass(frozen=True)
class Showing:
    """The way in which a command shows its verdict."""

    verbose: VerboseOption = False
    strict: StrictOption = False
    json: JsonOption = False


def scenario_with(name: str, given: dict[str, Any]) -> Scenario:
    """A scenario with some of its keys replaced."""
    from ptnsbc_sim.scenario import load_scenario  # loads numba, which `--help` does not need

    return load_scenario(name, given)


def _legs_in(path: Path | None) -> Any:
    """The mission of a file: the whole of it, or what stands below `mission`."""
    if path is None:
        return None
    from ptnsbc_sim.scenario import ScenarioError
    from ptnsbc_sim.scenario.reading.reader import parse, read_text

    tree = parse(read_text(path), str(path), begins="legs")
    found = tree.get("mission", tree)
    if not isinstance(found, dict) or "legs" not in found:
        raise ScenarioError(
            f"{path}: no legs: expected the key legs, or mission with legs below it"
        )
    return found
