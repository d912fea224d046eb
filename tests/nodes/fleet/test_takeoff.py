"""The start of a flight: from which places it is judged, who is started again, and why it does not begin."""

import math
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("pymavlink")

from ptnsbc_nodes.bridge.procedure.steps import Step
from ptnsbc_nodes.fleet import child_process, takeoff
from ptnsbc_nodes.fleet.child_process import Crew, FleetOptions, ProcessCommand
from ptnsbc_nodes.fleet.takeoff import FleetError, FlightCheck, Launch, TakeOff
from ptnsbc_sim.scenario import load_scenario

SCENARIO = load_scenario("experiment_4")
IDS = SCENARIO.uav_ids
HEIGHT_M = SCENARIO.mavlink.takeoff_height_m


class Vehicles:
    """The launcher's node as the check sees it; all vehicles stand a metre east of their starts."""

    def __init__(self):
        self.held = set()
        self.places = {f"bridge{i}": (*self.spot(i), 0.1) for i in IDS}
        self.vehicles = {name: vehicle(Step.CONTROLLER) for name in self.places}
        self.measured = {i: (*self.spot(i), HEIGHT_M + 0.1) for i in IDS}
        self.started, self.objections = [], {}
        self.lifecycle = self.status = self.leader = self

    @staticmethod
    def spot(uav):
        x, y, _ = SCENARIO.uav(uav).position
        return float(x) + 1.0, float(y)

    def missing(self, names):
        return {}

    def start(self, patience_s):
        self.started.append(patience_s)

    def begins_in_s(self):
        return 0.0

    def mute(self):
        pass


def vehicle(step, *, armed=False, landed=False):
    return SimpleNamespace(step=step.value, armed=armed, landed=landed)


def judge(objection=""):
    """A judge, and the starts of the flights that it was asked for."""
    seen = []

    def judges(scenario):
        seen.append({i: tuple(map(float, scenario.uav(i).position)) for i in IDS})
        return objection

    return judges, seen


def check_of(vehicles, judges, **more):
    options = FleetOptions(SCENARIO, **{"backend": "mavlink", "objection": judges, **more})
    return FlightCheck(options, vehicles)


def test_no_uav_process_becomes_active_before_the_flight_is_judged_from_above_the_vehicles():
    vehicles, (judges, seen) = Vehicles(), judge()
    check = check_of(vehicles, judges)
    assert vehicles.held == {f"uav{i}" for i in IDS} and check.holds
    assert check.before_arming() == ""
    assert seen == [{i: pytest.approx(place) for i, place in vehicles.measured.items()}]
    check.release()
    assert vehicles.held == set() and not check.holds


def test_a_vehicle_that_a_pilot_flew_up_is_judged_where_it_is():
    vehicles, (judges, seen) = Vehicles(), judge()
    vehicles.places["bridge2"] = (1.0, 2.0, 7.0)
    vehicles.vehicles["bridge2"] = vehicle(Step.CONTROLLER, armed=True)
    check_of(vehicles, judges).before_arming()
    assert seen[0][2] == (1.0, 2.0, 7.0)


def test_a_refused_flight_keeps_all_vehicles_from_arming():
    vehicles = Vehicles()
    check = check_of(vehicles, judge("UAV 2 is late")[0])
    assert check.before_arming() == "UAV 2 is late"
    assert check.holds


def test_every_bridge_must_know_where_its_vehicle_is():
    vehicles = Vehicles()
    check = check_of(vehicles, judge()[0])
    assert not check.lost()
    vehicles.vehicles["bridge3"] = vehicle(Step.STATE)
    assert check.lost()
    vehicles.vehicles["bridge3"] = vehicle(Step.READY)  # of another computer, which holds nothing
    assert not check.lost()
    del vehicles.places["bridge3"]
    assert check.lost()


def test_what_a_bridge_objects_is_told_before_any_dry_run():
    vehicles, (judges, seen) = Vehicles(), judge()
    vehicles.objections = {
        "bridge1": "",
        "bridge2": "its position is known to 0.90 m: expected 0.14",
    }
    check = check_of(vehicles, judges)
    assert check.before_arming() == f"bridge2: {vehicles.objections['bridge2']}"
    assert check.holds and seen == []


def test_simulated_vehicles_are_where_the_file_says():
    vehicles, (judges, seen) = Vehicles(), judge("UAV 2 is late")
    assert not check_of(vehicles, judges, backend="sim").holds
    launched(vehicles, judges, backend="sim")
    assert seen == []


def test_an_operator_lets_vehicles_arm_once_all_know_where_they_are_and_the_flight_was_judged():
    vehicles, (judges, seen) = Vehicles(), judge()
    assert "arm by themselves" in check_of(vehicles, judges).refusal()
    assert "need no arming" in check_of(vehicles, judges, backend="sim", wait=True).refusal()
    check = check_of(vehicles, judges, wait=True)
    vehicles.vehicles["bridge3"] = vehicle(Step.STATE)
    assert check.refusal() == "bridge3: waiting for a valid position"
    vehicles.vehicles["bridge3"] = vehicle(Step.CONTROLLER)
    assert check.refusal().startswith("dry runs")
    check.before_arming()
    assert check.refusal() == "" and len(seen) == 1
    check.release()
    assert check.refusal() == "the vehicles may arm already"


def test_without_dry_runs_too_vehicles_wait_for_their_operator():
    vehicles = Vehicles()
    vehicles.begun, vehicles.listen_for_start = False, lambda: None
    orders = iter(("arm", "start"))

    def look(take_off):
        order = next(orders)
        assert bool(vehicles.held) == (order == "arm")
        take_off._check.may_arm, vehicles.begun = True, order == "start"

    said = launched(vehicles, None, look, wait=True)
    assert vehicles.begun and vehicles.started == []
    assert said[0] == "the vehicles arm when an operator calls /formation/arm"
    assert said[1].endswith("when an operator calls /formation/start")


def launched(vehicles, judges, look=lambda _: None, **more):
    options = FleetOptions(SCENARIO, **{"backend": "mavlink", "objection": judges, **more})
    stop, said = SimpleNamespace(came=False), []
    take_off = TakeOff(Launch(options, Crew({}, None, vehicles), vehicles, stop, said.append))

    def wait(_deadline):
        look(take_off)
        return True

    take_off._wait = wait
    take_off._start_flight(0.0)
    return said


def test_the_launcher_starts_only_what_is_not_refused():
    vehicles = Vehicles()
    assert "may arm" in launched(vehicles, judge()[0])[0]
    assert len(vehicles.started) == 1
    with pytest.raises(FleetError, match="stand nothing is armed: UAV 2 is late"):
        launched(Vehicles(), judge("UAV 2 is late")[0])


def test_the_dry_runs_are_flown_once_wherever_the_vehicles_have_drifted_in_the_air():
    vehicles, (judges, seen) = Vehicles(), judge()

    def drift(_):
        vehicles.places = {name: (x + 3.0, y, z) for name, (x, y, z) in vehicles.places.items()}

    launched(vehicles, judges, drift)
    assert len(seen) == 1 and len(vehicles.started) == 1


class Loaded:
    """A process that has loaded."""

    life = 1

    def __init__(self, command):
        self.command, self.name, self.pid, self.exit_code = command, command.name, 7, None
        self.reports = SimpleNamespace(running=True)


class Network:
    """The node of a launcher that hears some processes; the others wait to be introduced."""

    def __init__(self, heard=(), sees=(), asked=()):
        self.status = self.lifecycle = self
        self.waiting = dict.fromkeys(heard, "")
        self.seen, self.was_asked = sees, asked
        self.done = []

    def sees(self, node):
        return node in self.seen

    def asked(self, name):
        return name in self.was_asked

    def rejoin(self):
        self.done.append("joined again")

    def manage(self, name, _node):
        self.done.append(f"managed {name}")


@pytest.fixture
def renewed(monkeypatch):
    monkeypatch.setattr(takeoff, "_UNHEARD_S", 0.0)

    def renewed(network: Network, *names: str, looks: int = 1) -> tuple[list[str], list[str]]:
        """The steps taken about processes that have loaded, and the arguments of those started again."""
        crew = Crew({}, None, network)
        introduction = takeoff.Introduction(Launch(None, crew, network, None, lambda _: None))
        started: list[str] = []
        monkeypatch.setattr(takeoff, "end", lambda ended: network.done.append(ended[0].name))

        def launch(command, *_):
            started.extend(command.arguments)
            return Loaded(command)

        monkeypatch.setattr(child_process, "ChildProcess", launch)
        for name in names:
            command = ProcessCommand(
                name, "none", (), managed=f"/{name}", ends=name.startswith("bridge")
            )
            crew.children.append(Loaded(command))
        for _ in range(looks):
            introduction.look()
        return network.done, started

    return renewed


def test_a_process_that_nobody_hears_is_started_again(renewed):
    done, _ = renewed(Network(heard=["uav1"]), "uav1", "uav2")
    assert done == ["uav2", "managed uav2"]


def test_who_is_heard_is_left_alone(renewed):
    done, _ = renewed(Network(heard=["uav1"], sees=["recorder"]), "recorder", "uav1", looks=3)
    assert done == []


def test_a_recorder_that_is_left_out_replaces_its_own_empty_bag(renewed):
    done, arguments = renewed(Network(heard=["uav1"]), "recorder", "uav1")
    assert done[0] == "recorder"
    assert arguments == ["--overwrite"]


def test_a_launcher_that_hears_nobody_joins_again_before_it_ends_a_process(renewed):
    done, _ = renewed(Network(), "uav1", "uav2", looks=2)
    assert done == ["joined again", "uav1", "managed uav1"]


def test_a_bridge_that_was_asked_to_act_may_be_flying(renewed):
    assert renewed(Network(heard=["uav1"], asked=["bridge1"]), "uav1", "bridge1")[0] == []
    done, _ = renewed(Network(heard=["uav1"]), "uav1", "bridge1")
    assert done == ["bridge1", "managed bridge1"]


@pytest.mark.parametrize(
    ("running", "says"),
    [
        (False, "uav1 of another fleet is in domain 7: expected another domain"),
        (True, "uav1 refused to be activated, uav1.log"),
    ],
)
def test_a_uav_that_refuses_before_its_process_has_loaded_is_of_another_fleet(running, says):
    node = SimpleNamespace(
        domain=7,
        lifecycle=SimpleNamespace(held=set(), refused=["uav1"]),
        status=SimpleNamespace(waiting={}, missing=lambda names: dict.fromkeys(names, "its first")),
        attach=lambda _join: None,
        spin=lambda _seconds: None,
    )
    child = Loaded(ProcessCommand("uav1", "module", (), (1,)))
    child.log, child.tail = "uav1.log", lambda: ""
    child.reports = SimpleNamespace(running=running)
    options, stop = FleetOptions(load_scenario("paper_5")), SimpleNamespace(came=False)
    crew = Crew({}, None, node.lifecycle)
    crew.children.append(child)
    with pytest.raises(FleetError, match=says):
        TakeOff(Launch(options, crew, node, stop, print)).run([], math.inf)
