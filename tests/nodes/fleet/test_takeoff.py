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
        self.places = {f"bridge{i}": (*self.spot(i), 0.1) for i in IDS}
        self.vehicles = {name: vehicle(Step.CONTROLLER) for name in self.places}
        self.measured = {i: (*self.spot(i), HEIGHT_M + 0.1) for i in IDS}
        self.started, self.objections = [], {}
        self.status = self.leader = self

    @staticmethod
    def spot(uav):
        x, y, _ = SCENARIO.uav(uav).position
        return float(x) + 1.0, float(y)

    def missing(self, names):
        return {}

    def start(self, patience_s):
        self.started.append(patience_s)

    begun = False

    def listen_for_start(self):
        pass

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


def test_the_flight_is_judged_from_above_the_vehicles():
    vehicles, (judges, seen) = Vehicles(), judge()
    check = check_of(vehicles, judges)
    assert check.holds
    assert check.before_arming() == ""
    assert seen == [{i: pytest.approx(place) for i, place in vehicles.measured.items()}]


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
    check.holds = False
    assert check.refusal() == "the vehicles may arm already"


def test_without_dry_runs_too_vehicles_wait_for_their_operator():
    vehicles = Vehicles()
    vehicles.begun, vehicles.listen_for_start = False, lambda: None
    orders = iter(("arm", "start"))

    def look(take_off):
        order = next(orders)
        assert take_off._check.holds == (order == "arm")
        take_off._check.may_arm, vehicles.begun = True, order == "start"

    said = launched(vehicles, None, look, wait=True)
    assert vehicles.begun and vehicles.started == []
    assert said[0] == "the vehicles arm when an operator calls /formation/arm"
    assert said[1].endswith("when an operator calls /formation/start")


def launched(vehicles, judges, look=lambda _: None, commands=(), **more):
    options = FleetOptions(SCENARIO, **{"backend": "mavlink", "objection": judges, **more})
    stop, said = SimpleNamespace(came=False), []
    take_off = TakeOff(Launch(options, Crew({}, None), vehicles, stop, said.append))

    def wait(_deadline):
        look(take_off)
        return True

    take_off._wait = wait
    vehicles.attach = lambda _join: None
    take_off.run(commands, 0.0)
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


BRIDGE_AND_UAV = [
    ProcessCommand("bridge1", child_process.BRIDGE, (), (1,), ends=True),
    ProcessCommand("uav1", child_process.UAV, (), (1,)),
]


@pytest.fixture
def started(monkeypatch):
    """Names of the processes that were started, in their order."""
    names = []

    def launch(command, *_):
        names.append(command.name)
        return Loaded(command)

    monkeypatch.setattr(child_process, "ChildProcess", launch)
    return names


def test_without_its_uav_process_nothing_arms_and_that_is_started_when_the_flight_is_judged(
    started,
):
    vehicles = Vehicles()
    vehicles.waiting = {}

    def look(_take_off):
        assert started == ["bridge1"] or vehicles.waiting
        vehicles.waiting["bridge1"] = "waiting for setpoints"

    def judges(_scenario):
        assert started == ["bridge1"]
        return ""

    launched(vehicles, judges, look, commands=BRIDGE_AND_UAV)
    assert started == ["bridge1", "uav1"] and len(vehicles.started) == 1


def test_no_uav_process_is_started_for_a_flight_that_is_refused(started):
    vehicles = Vehicles()
    vehicles.waiting = {"bridge1": ""}
    with pytest.raises(FleetError, match="stand nothing is armed: UAV 2 is late"):
        launched(vehicles, judge("UAV 2 is late")[0], commands=BRIDGE_AND_UAV)
    assert started == ["bridge1"]


def test_without_any_check_too_a_bridge_is_heard_before_its_vehicle_may_arm(started):
    vehicles, seen = Vehicles(), []
    vehicles.waiting = {}

    def look(_take_off):
        seen.append([*started])
        vehicles.waiting["bridge1"] = ""

    launched(vehicles, None, look, commands=BRIDGE_AND_UAV)
    assert seen[0] == ["bridge1"] and started == ["bridge1", "uav1"]


class Loaded:
    """A process that has loaded."""

    life = 1

    def __init__(self, command):
        self.command, self.name, self.pid, self.exit_code = command, command.name, 7, None
        self.reports = SimpleNamespace(running=True)


class Network:
    """The node of a launcher that hears some processes; the others wait to be introduced."""

    def __init__(self, heard=(), sees=(), steps=None):
        self.status = self
        self.waiting = dict.fromkeys(heard, "")
        self.vehicles = {name: vehicle(step) for name, step in (steps or {}).items()}
        self.seen, self.done = sees, []

    def sees(self, node):
        return node in self.seen

    def rejoin(self):
        self.done.append("joined again")


@pytest.fixture
def renewed(monkeypatch):
    monkeypatch.setattr(takeoff, "_UNHEARD_S", 0.0)

    def renewed(network, *names, looks=1, **options):
        """The steps taken about processes that have loaded, and the arguments of those started again."""
        crew, fleet = Crew({}, None), FleetOptions(SCENARIO, **options)
        introduction = takeoff.Introduction(Launch(fleet, crew, network, None, lambda _: None))
        started: list[str] = []
        monkeypatch.setattr(takeoff, "end", lambda ended: network.done.append(ended[0].name))

        def launch(command, *_):
            started.extend(command.arguments)
            return Loaded(command)

        monkeypatch.setattr(child_process, "ChildProcess", launch)
        for name in names:
            kind, number = name.rstrip("0123456789"), name.lstrip("abcdefghijklmnopqrstuvwxyz")
            module = {"bridge": child_process.BRIDGE, "uav": child_process.UAV}.get(kind, kind)
            uavs = (int(number),) if number else ()
            crew.children.append(Loaded(ProcessCommand(name, module, (), uavs)))
        for _ in range(looks):
            introduction.look()
        return network.done, started

    return renewed


def test_a_process_that_nobody_hears_is_started_again(renewed):
    done, _ = renewed(Network(heard=["uav1"]), "uav1", "uav2")
    assert done == ["uav2"]


def test_who_is_heard_is_left_alone(renewed):
    done, _ = renewed(Network(heard=["uav1"], sees=["recorder"]), "recorder", "uav1", looks=3)
    assert done == []


def test_a_recorder_that_is_left_out_replaces_its_own_empty_bag(renewed):
    done, arguments = renewed(Network(heard=["uav1"]), "recorder", "uav1")
    assert done[0] == "recorder"
    assert arguments == ["--overwrite"]


def test_a_launcher_that_hears_nobody_joins_again_before_it_ends_a_process(renewed):
    done, _ = renewed(Network(), "uav1", "uav2", looks=2)
    assert done == ["joined again", "uav1"]


def test_a_process_that_may_fly_a_real_vehicle_is_left_alone(renewed):
    """The launcher does not hear it, but the others may: without its UAV process a vehicle arms nothing."""
    real = {"backend": "mavlink"}
    assert renewed(Network(heard=["bridge2"]), "bridge2", "bridge1", **real)[0] == ["bridge1"]
    elsewhere = frozenset({"recorder", "bridge1", "bridge2"})
    assert (
        renewed(Network(heard=["bridge2"]), "bridge2", "bridge1", only=elsewhere, **real)[0] == []
    )
    for step, done in ((Step.CONTROLLER, ["uav1"]), (Step.STREAM, []), (Step.FLY, [])):
        heard = Network(heard=["bridge1"], steps={"bridge1": step})
        assert renewed(heard, "bridge1", "uav1", **real)[0] == done
    assert renewed(Network(heard=["uav2"]), "uav2", "uav1", **real)[0] == []


@pytest.mark.parametrize("running", [False, True])
def test_a_uav_that_is_heard_before_its_process_has_loaded_is_of_another_fleet(running):
    node = SimpleNamespace(
        domain=7, status=SimpleNamespace(waiting={"uav1": ""}), spin=lambda _seconds: None
    )
    child = Loaded(ProcessCommand("uav1", "module", (), (1,)))
    child.reports = SimpleNamespace(running=running)
    crew, stop = Crew({}, None), SimpleNamespace(came=False)
    crew.children.append(child)
    take_off = TakeOff(Launch(FleetOptions(load_scenario("paper_5")), crew, node, stop, print))
    if running:
        assert take_off._wait(math.inf)
        return
    with pytest.raises(FleetError, match="uav1 of another fleet is in domain 7: expected another"):
        take_off._wait(math.inf)
