"""The launch files, evaluated: with ROS's own `launch` where it is, and with a stand-in everywhere."""

from __future__ import annotations

import asyncio
import importlib.util
import re
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

import ament_index_python.packages as index
from typer.testing import CliRunner

from ptnsbc_nodes.bridge import bridge_main
from ptnsbc_nodes.runtime.environment import ONE_THREAD
from ptnsbc_nodes.uav import uav_main
from ptnsbc_tools.cli import app
from ptnsbc_tools.commands import fleet as fleet_command

ROOT = Path(__file__).resolve().parents[1]
BRINGUP = ROOT / "ros2_ws" / "src" / "ptnsbc_bringup"
NO_LAUNCH = "ROS's launch_ros is not installed: it comes with ROS from apt and has no wheel"


def _stand_in():
    path = ROOT / "tests" / "support" / "launch_stand_in.py"
    spec = importlib.util.spec_from_file_location("launch_stand_in", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Started(SimpleNamespace):
    """A process as a launch file wants it."""


class StandIn:
    """Launch files evaluated with the stand-in."""

    def __init__(self, monkeypatch):
        self.api = _stand_in()
        self.api.install(monkeypatch)
        self.context = self.api.LaunchContext()

    def started(self, entity):
        if isinstance(entity, self.api.ExecuteProcess):
            return Started(cmd=entity.cmd)
        if isinstance(entity, self.api.Node):
            return Started(
                package=entity.package,
                executable=entity.executable,
                namespace=entity.namespace,
                arguments=entity.arguments,
                parameters=entity.parameters or [],
            )
        return None

    def after(self, entities, code):
        """What the end of the flight leads to."""
        (handler,) = [e.event_handler for e in entities if hasattr(e, "event_handler")]
        return handler.handle(self.api.ProcessExited(returncode=code), self.context)


class Real:
    """The same with ROS's own launch."""

    def __init__(self, _monkeypatch):
        import launch
        import launch_ros.actions

        self._launch, self._node = launch, launch_ros.actions.Node
        self.context = launch.LaunchContext()

    def started(self, entity):
        if isinstance(entity, self._node):
            private = vars(entity)
            return Started(
                package=private["_Node__package"],
                executable=private["_Node__node_executable"],
                namespace=private["_Node__node_namespace"],
                arguments=list(private["_Node__arguments"] or ()),
                parameters=[self._file(one) for one in private["_Node__parameters"] or ()],
            )
        if isinstance(entity, self._launch.actions.ExecuteProcess):
            words = entity.process_description.cmd
            return Started(cmd=["".join(p.perform(self.context) for p in word) for word in words])
        return None

    def _file(self, parameters):
        is_file = hasattr(parameters, "param_file")
        return str(parameters.evaluate(self.context)) if is_file else parameters

    def after(self, entities, code):
        (handler,) = [
            e.event_handler
            for e in entities
            if isinstance(e, self._launch.actions.RegisterEventHandler)
        ]
        event = self._launch.events.process.ProcessExited(
            returncode=code, action=None, name="fleet", cmd=[], cwd=None, env=None, pid=1
        )
        return handler.handle(event, self.context)


@pytest.fixture(params=["stand-in", "real"])
def kind(request, monkeypatch):
    monkeypatch.setattr(index, "get_package_share_directory", lambda name: str(BRINGUP))
    if request.param == "stand-in":
        return StandIn(monkeypatch)
    if importlib.util.find_spec("launch_ros") is None:
        pytest.skip(NO_LAUNCH)
    return Real(monkeypatch)


@pytest.fixture
def viewers(monkeypatch):
    """The viewers that are installed."""
    installed = {"rviz2", "foxglove_bridge"}

    def prefix(name):
        if name != "ptnsbc_tools" and name not in installed:
            raise index.PackageNotFoundError(name)
        return "/prefix"

    monkeypatch.setattr(index, "get_package_prefix", prefix)
    return installed


@pytest.fixture
def evaluate(kind, viewers):
    """Evaluates a launch file: the entities it comes down to."""

    def run(name, **arguments):
        file = runpy.run_path(str(BRINGUP / "launch" / f"{name}.launch.py"))
        kind.context.launch_configurations.update(arguments)
        found = []
        for entity in file["generate_launch_description"]().entities:
            found += entity.visit(kind.context) or []
        return found

    return run


def processes(kind, entities):
    """Those that would be started."""
    return [one for one in map(kind.started, entities) if one is not None]


@pytest.fixture
def flown(monkeypatch):
    """What `ptnsbc fleet` understands of its words, without flying."""
    calls = []

    def fly(scenario, parts, showing, *, check, views):
        calls.append((scenario, {**vars(parts), "check": check}, views))
        return 0

    monkeypatch.setattr(fleet_command, "fly_and_judge", fly)

    def ask(words):
        result = CliRunner().invoke(app, words)
        assert result.exit_code == 0, result.output
        scenario, given, views = calls[-1]
        assert views == fleet_command.Views()
        return scenario, given

    return ask


def test_a_fleet_is_that_of_the_command(kind, evaluate, flown, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (one,) = processes(kind, evaluate("fleet"))
    assert one.cmd[0] == "/prefix/lib/ptnsbc_tools/ptnsbc"
    scenario, given = flown(one.cmd[1:])
    assert scenario.name == "paper_5"
    assert given == {
        "lockstep": False, "backend": "sim", "allow_arming": False, "only": "", "namespace": "",
        "bag": None, "overwrite": False, "check": None,
        "processes": None, "wait": False,
    }  # fmt: skip


def test_every_argument_arrives(kind, evaluate, flown, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    entities = evaluate(
        "fleet", scenario="experiment_4", backend="mavlink", allow_arming="true", lockstep="true",
        namespace="blue", duration="12.5", record="flight", overwrite="true", check="true",
        wait="true",
        set="gains.formation.kappa_1_s=1.5 'world.wind_m_s=[1, 0, 0]'",
    )  # fmt: skip
    (one,) = processes(kind, entities)
    scenario, given = flown(one.cmd[1:])
    assert (scenario.name, scenario.timing.duration_s) == ("experiment_4", 12.5)
    assert scenario.gains.formation.kappa_1_s == 1.5
    assert list(scenario.world.wind_m_s) == [1.0, 0.0, 0.0]
    assert given == {
        "lockstep": True, "backend": "mavlink", "allow_arming": True, "only": "",
        "namespace": "/blue", "bag": tmp_path / "flight", "overwrite": True, "check": True,
        "processes": None, "wait": True,
    }  # fmt: skip


def test_a_mission_arrives(kind, evaluate):
    (one,) = processes(kind, evaluate("fleet", mission="legs.yaml"))
    assert one.cmd[-2:] == ["--mission", "legs.yaml"]


@pytest.mark.parametrize(
    ("viewer", "package"), [("rviz", "rviz2"), ("foxglove", "foxglove_bridge")]
)
def test_viewers_come_when_asked_for_and_go_with_the_flight(kind, evaluate, viewer, package):
    assert len(processes(kind, evaluate("fleet"))) == 1
    entities = evaluate("fleet", **{viewer: "true"})
    assert [one.package for one in processes(kind, entities)[1:]] == [package]
    (end,) = kind.after(entities, 0)
    matches = end.event.process_matcher
    assert [matches(entity) for entity in entities if kind.started(entity)] == [False, True]


def test_rviz_shows_the_fleet_of_the_namespace(kind, evaluate):
    for namespace, expected in (("", []), ("/blue", ["/formation/markers", "/clock"])):
        viewer = processes(kind, evaluate("fleet", rviz="true", namespace=namespace))[1]
        renamed = [word for word in viewer.arguments if ":=" in word]
        assert renamed == [f"{topic}:=/blue{topic}" for topic in expected]
    layout = (BRINGUP / "rviz" / "formation.rviz").read_text()
    assert re.findall(r"Value: (/.+)", layout) == ["/formation/markers"]


def test_a_viewer_that_is_missing_is_named_before_anything_starts(evaluate, viewers):
    viewers.remove("rviz2")
    with pytest.raises(RuntimeError, match=r"rviz2 is not installed: .*ros-jazzy-rviz2"):
        evaluate("fleet", rviz="true")


@pytest.mark.parametrize("code", [0, 1, 130])
def test_launch_fails_with_the_flight_and_runs_on(kind, evaluate, code):
    told = []
    loop = asyncio.new_event_loop()
    loop.set_exception_handler(lambda _loop, problem: told.append(problem["message"]))
    if isinstance(kind, StandIn):
        kind.context.asyncio_loop = loop
    else:
        kind.context._set_asyncio_loop(loop)
    # What launch includes beside this flight goes on: nothing here shuts it down.
    assert kind.after(evaluate("fleet"), code) == []
    assert told == ([f"the flight of paper_5 ended with {code}"] if code else [])
    loop.close()


@pytest.fixture
def understood(monkeypatch):
    """Whether a process understands its arguments, without running it."""
    bodies = {"uav": (uav_main, "_fly"), "bridge": (bridge_main, "_bridge")}
    for module, body in bodies.values():
        monkeypatch.setattr(module, body, lambda arguments, _argv: 0)

    def ask(one):
        # As launch_ros starts it.
        words = [*one.arguments, "--ros-args", "-r", f"__ns:=/{one.namespace}"]
        return bodies[one.executable][0].main(words) == 0

    return ask


def test_a_launched_uav_understands_its_arguments(kind, evaluate, understood):
    for one in processes(kind, evaluate("uav", uav="2", scenario="experiment_4", bridge="true")):
        assert understood(one), one


def test_one_uav_flies_the_scenario_with_other_values(kind, evaluate):
    entities = evaluate(
        "uav", uav="2", scenario="fleet.yaml", set="seed=3 'world.wind_m_s=[1, 0, 0]'"
    )
    (controller,) = processes(kind, entities)
    assert (controller.executable, controller.namespace) == ("uav", "uav2")
    values = ["--set", "seed=3", "--set", "world.wind_m_s=[1, 0, 0]"]
    assert controller.arguments == ["--uav", "2", "--scenario", "fleet.yaml", *values]


def test_one_uav_with_its_bridge_arms_only_when_told_to(kind, evaluate):
    quiet = processes(kind, evaluate("uav", uav="1", scenario="experiment_4", bridge="true"))
    assert [one.executable for one in quiet] == ["uav", "bridge"]
    assert "--bridged" in quiet[0].arguments
    assert not any("--allow-arming" in one.arguments for one in quiet)
    armed = processes(
        kind,
        evaluate(
            "uav", uav="1", scenario="experiment_4", bridge="true", allow_arming="true",
        ),
    )  # fmt: skip
    assert {"--allow-arming", "--with-fleet"} <= {*armed[1].arguments}


def test_an_argument_outside_its_choices_is_refused(evaluate):
    with pytest.raises(RuntimeError, match="backend"):
        evaluate("fleet", backend="gazebo")
    with pytest.raises(RuntimeError, match="uav"):
        evaluate("uav")


def test_launch_files_import_nothing_of_ours():
    """`ros2` runs in the system's interpreter; numba and pydantic are in another one."""
    for file in (BRINGUP / "launch").glob("*.launch.py"):
        assert "import ptnsbc" not in (text := file.read_text()), file
        assert "from ptnsbc" not in text, file


def test_a_launched_process_computes_in_one_thread(kind):
    file = runpy.run_path(str(BRINGUP / "launch" / "uav.launch.py"))
    assert file["ONE_THREAD"] == ONE_THREAD
