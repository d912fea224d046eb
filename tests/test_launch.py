"""The launch files, evaluated: with ROS's own `launch` where it is, and with a stand-in everywhere."""

from __future__ import annotations

import importlib.util
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

from ptnsbc_nodes.bridge import main as bridge_main
from ptnsbc_nodes.fleet import coordinator_main
from ptnsbc_nodes.fleet.child_process import EXECUTABLES
from ptnsbc_nodes.fleet.process_list import FleetOptions, commands
from ptnsbc_nodes.fleet.supervisor import FleetError
from ptnsbc_nodes.recording import main as recorder_main
from ptnsbc_nodes.runtime import warmup
from ptnsbc_nodes.sim import main as sim_main
from ptnsbc_nodes.uav import main as uav_main
from ptnsbc_sim.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[1]
BRINGUP = ROOT / "ros2_ws" / "src" / "ptnsbc_bringup"
NO_LAUNCH = "ROS's launch_ros is not installed: it comes with ROS from apt and has no wheel"


def _load(name):
    path = ROOT / "tests" / "support" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Started(SimpleNamespace):
    """A node as a launch file wants it."""


class StandIn:
    """Launch files evaluated with the stand-in."""

    def __init__(self, monkeypatch):
        self.api = _load("launch_stand_in")
        self.api.install(monkeypatch, BRINGUP)

    def started(self, node) -> Started:
        return Started(
            package=node.package,
            executable=node.executable,
            namespace=node.namespace,
            arguments=node.arguments,
            parameters=node.parameters or [],
        )

    def is_node(self, entity):
        return isinstance(entity, self.api.Node)

    def context(self):
        return self.api.LaunchContext()


class Real:
    """The same with ROS's own launch."""

    def __init__(self, monkeypatch):
        import ament_index_python.packages as index
        import launch
        import launch_ros.actions

        monkeypatch.setattr(index, "get_package_share_directory", lambda name: str(BRINGUP))
        self._launch, self._node = launch, launch_ros.actions.Node

    def started(self, node) -> Started:
        private = vars(node)
        return Started(
            package=private["_Node__package"],
            executable=private["_Node__node_executable"],
            namespace=private["_Node__node_namespace"],
            arguments=list(private["_Node__arguments"] or ()),
            parameters=private["_Node__parameters"] or [],
        )

    def is_node(self, entity):
        return isinstance(entity, self._node)

    def context(self):
        return self._launch.LaunchContext()


@pytest.fixture(params=["stand-in", "real"])
def kind(request, monkeypatch):
    if request.param == "stand-in":
        return StandIn(monkeypatch)
    if importlib.util.find_spec("launch_ros") is None:
        pytest.skip(NO_LAUNCH)
    return Real(monkeypatch)


@pytest.fixture
def evaluate(kind, monkeypatch):
    """Evaluates a launch file: the entities it comes down to."""
    for load in ("load_agent", "load_world"):  # compiles; other tests do
        monkeypatch.setattr(warmup, load, lambda *_: None)

    def run(name, **arguments):
        file = runpy.run_path(str(BRINGUP / "launch" / f"{name}.launch.py"))
        context = kind.context()
        context.launch_configurations.update(arguments)
        found = []
        for entity in file["generate_launch_description"]().entities:
            found += entity.visit(context) or []
        return found, context

    return run


def nodes(kind, entities, context):
    """Those that would be started."""
    return [
        kind.started(entity)
        for entity in entities
        if kind.is_node(entity) and (entity.condition is None or entity.condition.evaluate(context))
    ]


@pytest.mark.parametrize("backend", ["sim", "mavlink"])
@pytest.mark.parametrize("lockstep", ["true", "false"])
@pytest.mark.parametrize("record", ["", "flight"])
def test_a_fleet_is_that_of_our_launcher(
    kind, evaluate, tmp_path, monkeypatch, backend, lockstep, record
):
    monkeypatch.chdir(tmp_path)
    if backend == "mavlink" and lockstep == "true":
        with pytest.raises(FleetError, match="real vehicles do not wait"):
            evaluate("fleet", backend=backend, lockstep=lockstep)
        return
    scenario = load_scenario("experiment_4")
    found = evaluate(
        "fleet", scenario="experiment_4", backend=backend, lockstep=lockstep, record=record,
        allow_arming="true",
    )  # fmt: skip
    started = nodes(kind, *found)
    (file,) = {words.arguments[words.arguments.index("--scenario") + 1] for words in started[-1:]}
    options = FleetOptions(
        scenario.bridged() if backend == "mavlink" else scenario,
        lockstep=lockstep == "true",
        backend=backend,
        allow_arming=True,
        bag=tmp_path / record if record else None,
    )
    expected = [
        (EXECUTABLES[one.module], list(one.arguments)) for one in commands(options, Path(file))
    ]
    assert [(one.executable, one.arguments) for one in started[:-1]] == expected
    assert {one.package for one in started} == {"ptnsbc_nodes"}
    assert started[-1].executable == "coordinator"
    for one in started:
        wanted = "uav" if one.executable in ("uav", "bridge") else ""
        assert one.namespace.rstrip("1234") == wanted
    assert load_scenario(file).file == options.scenario.file


def test_nothing_is_armed_without_a_word(evaluate):
    with pytest.raises(FleetError, match="--allow-arming"):
        evaluate("fleet", scenario="experiment_4", backend="mavlink")


@pytest.mark.parametrize(
    ("viewer", "package"), [("rviz", "rviz2"), ("foxglove", "foxglove_bridge")]
)
def test_viewers_come_when_asked_for(kind, evaluate, viewer, package):
    assert package in {one.package for one in nodes(kind, *evaluate("fleet", **{viewer: "true"}))}
    assert package not in {one.package for one in nodes(kind, *evaluate("fleet"))}


@pytest.fixture
def understood(monkeypatch):
    """Whether a process understands its arguments, without running it."""
    bodies = {"uav": (uav_main, "_fly"), "sim": (sim_main, "_simulate")}
    bodies |= {"bridge": (bridge_main, "_bridge"), "coordinator": (coordinator_main, "_serve")}
    for module, body in bodies.values():
        monkeypatch.setattr(module, body, lambda arguments, _argv: 0)

    def ask(one):
        if one.executable == "recorder":
            return recorder_main._parser().parse_args(one.arguments) is not None
        # As launch_ros starts it.
        words = [*one.arguments, "--ros-args", "-r", f"__ns:=/{one.namespace}"]
        return bodies[one.executable][0].main(words) == 0

    return ask


@pytest.mark.parametrize("backend", ["sim", "mavlink"])
def test_what_is_launched_understands_its_arguments(kind, evaluate, understood, backend):
    arguments = {"scenario": "experiment_4", "backend": backend, "allow_arming": "true"}
    for one in nodes(kind, *evaluate("fleet", record="bag", **arguments)):
        assert understood(one), one
    for one in nodes(kind, *evaluate("uav", uav="2", scenario="experiment_4", bridge="true")):
        assert understood(one), one


def test_one_uav_flies_by_a_parameter_file(kind, evaluate):
    (controller,) = nodes(kind, *evaluate("uav", uav="2", params="/a/fleet.yaml"))
    assert (controller.executable, controller.namespace) == ("uav", "uav2")
    assert controller.arguments == ["--uav", "2"]
    assert "/a/fleet.yaml" in map(str, controller.parameters)


def test_one_uav_with_its_bridge_arms_only_when_told_to(kind, evaluate):
    quiet = nodes(kind, *evaluate("uav", uav="1", scenario="experiment_4", bridge="true"))
    assert [one.executable for one in quiet] == ["uav", "bridge"]
    assert "--bridged" in quiet[0].arguments
    assert not any("--allow-arming" in one.arguments for one in quiet)
    armed = nodes(
        kind,
        *evaluate(
            "uav", uav="1", scenario="experiment_4", bridge="true", allow_arming="true",
            autostart="false",
        ),
    )  # fmt: skip
    assert "--allow-arming" in armed[1].arguments
    assert all("--managed" in one.arguments for one in armed)


def test_an_argument_outside_its_choices_is_refused(evaluate):
    with pytest.raises(RuntimeError, match="backend"):
        evaluate("fleet", backend="gazebo")
    with pytest.raises(RuntimeError, match="uav"):
        evaluate("uav")


class Follow:
    """What a launch file does when its processes end, one after the other."""

    def __init__(self, kind, entities):
        self._kind, self._entities = kind, entities
        self._nodes = [entity for entity in entities if kind.is_node(entity)]

    def end(self, index, returncode=0):
        """The reason for a shutdown, or the arguments of what is started."""
        found = []
        for entity in self._entities:
            handler = getattr(entity, "event_handler", None)
            if handler is not None and handler.target_action is self._nodes[index]:
                event = SimpleNamespace(returncode=returncode)
                found += handler.handle(event, None)
        return [
            self._kind.started(entity).arguments[-2:]
            if self._kind.is_node(entity)
            else entity.event.reason
            for entity in found
        ]


SIM = 5  # after the five UAVs
OVER, LOST_2 = ["the flight is over"], [["--lose", "uav2"]]
MAVLINK = {"scenario": "experiment_4", "backend": "mavlink", "allow_arming": "true"}


@pytest.mark.parametrize("lockstep", ["true", "false"])
@pytest.mark.parametrize(
    ("arguments", "ended"),
    [
        ({}, [(SIM, 0, OVER)]),
        ({}, [(SIM, 1, OVER)]),
        ({}, [(1, 1, LOST_2), (SIM, 0, OVER)]),
        ({"record": "flight"}, [(0, 1, [["--lose", "recorder"]])]),
        (
            {},
            [*((i, 0, [["--lose", f"uav{i + 1}"]]) for i in range(4)), (4, 0, ["no UAV is left"])],
        ),
        (MAVLINK, [(0, 0, []), (1, 0, []), (2, 0, []), (3, 0, OVER)]),  # every bridge has landed
        (MAVLINK, [(1, 1, LOST_2), (0, 0, []), (2, 0, []), (3, 0, OVER)]),
    ],
)
def test_what_ends_a_flight(evaluate, kind, lockstep, arguments, ended):
    if not isinstance(kind, StandIn):
        pytest.skip("asks the stand-in's event handlers")
    if "backend" in arguments and lockstep == "true":
        pytest.skip("real vehicles do not wait")
    entities, _ = evaluate("fleet", lockstep=lockstep, **arguments)
    follow = Follow(kind, entities)
    for index, code, what in ended:
        assert follow.end(index, code) == what, (index, code)
