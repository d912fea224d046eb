"""One UAV node, with everybody else played by the test."""

import json
import time
from datetime import datetime, timezone

import numpy as np
import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from ptnsbc_core.step import initial_state, step
from ptnsbc_core.types import NEVER_RECEIVED_S, AgentInputs
from ptnsbc_io import wire
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.comm.seal import Seal
from ptnsbc_nodes.comm.topics import LOST, READY
from ptnsbc_nodes.uav import main
from ptnsbc_nodes.uav.node import UavNode
from ptnsbc_sim.scenario import agent_config, load_scenario

pytestmark = pytest.mark.ros

FOLLOWER, PARENT, LEADER, NEIGHBOURS = 3, 2, 1, (2, 4)


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("paper_5")


def body(number: int) -> np.ndarray:
    odometry = np.zeros(13)
    odometry[0:3] = number, 0.5 * number, 1.0
    odometry[6] = 1.0
    return odometry


class Others:
    """Everybody that one UAV talks to: sends what it hears, keeps what it says."""

    def __init__(self, ros, scenario, uav_id, *, lockstep=True):
        self.ros, self.scenario, self.uav_id = ros, scenario, uav_id
        node = ros.node("others")
        self.node = node
        ends = Endpoints(node, lockstep)
        edges = CommunicationGraph(scenario, FlightOptions(lockstep=lockstep))
        senders = edges.senders(uav_id)
        self.send_odom = ends.publisher(topics.odom(uav_id), 1)
        self.send_near = ends.publisher(topics.near(uav_id), 1)
        self.send_state = {i: ends.publisher(topics.formation_state(i), 1) for i in senders.states}
        self.send_estimate = {
            i: ends.publisher(topics.leader_estimate(i), 1) for i in senders.estimators
        }
        self.lose = ends.publisher(LOST, 1)
        self.announce = None if uav_id == LEADER else ends.publisher(topics.EPOCH, 1)
        self.wrenches, self.states, self.status, self.epochs = [], [], [], []
        listen = ends.listen
        listen(topics.wrench_setpoint(uav_id), bytes, self.keep(self.wrenches, wire.decode_wrench))
        listen(topics.formation_state(uav_id), bytes, self.keep(self.states, wire.decode_odometry))
        for topic, readers in (
            (topics.formation_state(uav_id), edges.state_readers(uav_id) - 1),
            (topics.leader_estimate(uav_id), edges.estimate_readers(uav_id)),
        ):
            for _ in range(readers):
                listen(topic, bytes, lambda data: None)
        listen(topics.velocity_setpoint(uav_id), bytes, lambda data: None)
        for topic in (topics.DIAGNOSTICS, READY):
            listen(topic, bytes, self.keep(self.status, decode_status), required=topic is not READY)
        if uav_id == LEADER:
            listen(topics.EPOCH, bytes, self.keep(self.epochs, wire.decode_header))
            for _ in range(3):  # with the leader itself all UAVs, but no sim
                listen(topics.EPOCH, bytes, lambda data: None)
        self.template = wire.OdometryTemplate("vicon", "drone")  # of its own odometry: any frames
        self.uav = UavNode(
            ros.node("controller", namespace=f"/uav{uav_id}"), scenario, uav_id, edges
        )
        self.uav.activate()
        ros.spin_until(lambda: not ends.unread() and not ends.unheard())

    @staticmethod
    def keep(where, decode):
        return lambda data: where.append(decode(data))

    def odom(self, stamp_ns):
        self.send_odom(self.template.encode(stamp_ns, body(self.uav_id)))

    def near(self, stamp_ns, rows=()):
        rows = np.array(rows, dtype=float).reshape(-1, 7)
        self.send_near(wire.encode_near(stamp_ns, "map", rows))

    def neighbours(self, stamp_ns, without=()):
        for kind, frame in ((self.send_state, "uav{}/base_link"), (self.send_estimate, "map")):
            for i, send in kind.items():
                if i not in without:
                    template = wire.OdometryTemplate("map", frame.format(i))
                    send(template.encode(stamp_ns, body(i)))

    def form(self, stamp_ns=0, leg="form"):
        self.announce(wire.HeaderTemplate(leg).encode(stamp_ns))

    def settle(self):
        """Let everything sent so far arrive and be answered."""
        self.ros.spin_for(0.1)

    def ticks(self):
        return [wrench.stamp_ns // self.scenario.dt_ns for wrench in self.wrenches]

    def newest(self):
        self.status.clear()
        self.ros.spin_until(lambda: self.status)
        return self.status[-1]


def decode_status(data):
    (status,) = deserialize_message(data, DiagnosticArray).status
    return status.level, status.message, {pair.key: pair.value for pair in status.values}


def test_lockstep_tick_waits_for_all_it_needs(ros, scenario):
    others = Others(ros, scenario, FOLLOWER)
    dt = scenario.dt_ns
    others.odom(0)
    others.near(0)
    others.settle()
    assert others.ticks() == []  # the epoch is not known
    others.form()
    ros.spin_until(lambda: others.ticks() == [0])
    others.odom(dt)
    others.neighbours(0, without=(PARENT,))
    others.settle()
    assert others.ticks() == [0]
    others.neighbours(0)
    ros.spin_until(lambda: others.ticks() == [0, 1])
    assert others.states[-1].values[:7].tolist() == body(FOLLOWER)[:7].tolist()


def test_lockstep_output_is_that_of_the_kernel(ros, scenario):
    others = Others(ros, scenario, FOLLOWER)
    dt_ns = scenario.dt_ns
    rows = [[1.0, 2.0, 3.0, 0.5, 0.0, 0.25, 0.0]]
    others.form()
    for tick in range(3):
        others.odom(tick * dt_ns)
        if tick == 0:
            others.near(0, rows)
        else:
            others.neighbours((tick - 1) * dt_ns)
        ros.spin_until(lambda tick=tick: others.ticks() == list(range(tick + 1)))

    config = agent_config(scenario, FOLLOWER)
    state = initial_state(body(FOLLOWER), config)
    for tick in range(3):
        heard = tick > 0
        age = dt_ns * 1e-9 if heard else NEVER_RECEIVED_S
        told = AgentInputs(
            own=body(FOLLOWER),
            parent=body(PARENT) if heard else np.zeros(13),
            parent_age_s=age,
            leader=body(LEADER) if heard else np.zeros(13),
            leader_age_s=age,
            estimates=np.array([body(i) if heard else np.zeros(13) for i in NEIGHBOURS]),
            estimate_age_s=np.full(2, age),
            near=np.array(rows),
            near_age_s=tick * dt_ns * 1e-9,
            mode=0,
            start_age_s=tick * dt_ns * 1e-9,
        )
        state, out = step(state, told, tick * dt_ns * 1e-9, dt_ns * 1e-9, config)
        assert (
            others.wrenches[tick].values.tobytes() == np.array([*out.force, *out.torque]).tobytes()
        )


def test_lockstep_goes_on_without_a_lost_neighbour(ros, scenario):
    others = Others(ros, scenario, FOLLOWER)
    others.form()
    others.odom(0)
    others.near(0)
    ros.spin_until(lambda: others.ticks() == [0])
    others.odom(scenario.dt_ns)
    others.neighbours(0, without=(PARENT,))
    others.settle()
    assert others.ticks() == [0]
    others.lose(wire.HeaderTemplate(f"uav{PARENT}").encode(0))
    ros.spin_until(lambda: others.ticks() == [0, 1])


def test_lockstep_says_what_it_waits_for(ros, scenario):
    uav = UavNode(
        ros.node("controller"),
        scenario,
        FOLLOWER,
        CommunicationGraph(scenario, FlightOptions(lockstep=True)),
    )
    missing = uav.waiting_for()
    assert f"/uav{FOLLOWER}/odom" in missing
    assert f"/uav{PARENT}/formation_state" in missing
    assert f"/uav{FOLLOWER}/setpoint/wrench" in missing
    # Nobody but the recorder reads it, and there is none.
    assert f"/uav{FOLLOWER}/setpoint/velocity" not in missing
    # Not an edge of the tree.
    assert "/uav5/formation_state" not in missing


def call(ros, node, name):
    client = node.create_client(Trigger, f"/formation/{name}")
    ros.spin_until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    ros.spin_until(future.done)
    return future.result()


def test_leader_serves_the_legs_of_a_lockstep_flight(ros, scenario):
    others = Others(ros, scenario, LEADER)
    early = call(ros, others.node, "hold")
    assert not early.success
    assert "call /formation/start first" in early.message
    too_early = call(ros, others.node, "start")
    assert (too_early.success, too_early.message) == (
        False,
        "the leader waits for /formation/epoch",
    )
    Endpoints(others.node, lockstep=True).listen(topics.EPOCH, bytes, lambda data: None)
    ros.spin_until(lambda: not others.uav.waiting_for())
    assert call(ros, others.node, "start").success
    ros.spin_until(lambda: others.epochs == [(0, "form")])
    others.odom(0)
    others.near(0)
    ros.spin_until(lambda: others.ticks() == [0])
    assert call(ros, others.node, "land").success
    ros.spin_until(lambda: others.epochs == [(0, "form"), (500_000_000, "land")])


def test_real_time_hovers_before_the_epoch_and_flies_after_it(ros, scenario):
    others = Others(ros, scenario, LEADER, lockstep=False)
    assert f"/uav{LEADER}/odom" in others.newest()[2]["waiting_for"]
    others.odom(time.time_ns())
    ros.spin_until(lambda: others.wrenches)
    _, _, values = others.newest()
    assert (values["mode"], values["ready"]) == ("waiting", "true")
    before = time.time_ns()
    assert call(ros, others.node, "start").success
    ros.spin_until(lambda: others.epochs)
    assert others.epochs[0].frame_id == "form"
    assert before + 500_000_000 <= others.epochs[0].stamp_ns <= time.time_ns() + 500_000_000

    def flying():
        others.odom(time.time_ns())
        return others.status and others.status[-1][2]["mode"] == "form"

    ros.spin_until(flying)


def test_real_time_waits_for_its_recorder_before_the_flight_and_not_in_it(ros, scenario):
    """What is to be recorded must be heard from the first step on; a recorder that dies stops nobody."""
    edges = CommunicationGraph(scenario, FlightOptions(recorded=True))
    uav = UavNode(ros.node("controller"), scenario, FOLLOWER, edges)
    uav.activate()
    said = {topics.tick(FOLLOWER).name, topics.snapshot(FOLLOWER).name}
    assert said <= set(uav.waiting_for())
    assert topics.wrench_setpoint(FOLLOWER).name in uav.waiting_for()
    leader = Endpoints(ros.node("leader"), False).publisher(topics.EPOCH, 1)
    ros.spin_until(lambda: topics.EPOCH.name not in uav.waiting_for())
    leader(wire.HeaderTemplate("form").encode(time.time_ns() + 10**12))
    ros.spin_until(lambda: not said & set(uav.waiting_for()))


def test_the_leader_begins_when_every_uav_hears_it_and_not_others_instead(ros, scenario):
    """Viewers, a recorder beside and the sim hear the epoch too: their number says nothing."""
    uav = UavNode(
        ros.node("controller", namespace=f"/uav{LEADER}"),
        scenario,
        LEADER,
        CommunicationGraph(scenario, FlightOptions(recorded=True)),
    )
    uav.activate()
    for number in range(2 * len(scenario.uav_ids)):
        Endpoints(ros.node(f"viewer{number}"), False).listen(topics.EPOCH, bytes, lambda _: None)
    ros.spin_until(lambda: topics.EPOCH.name not in uav.waiting_for())

    def missing_listeners():
        return {what for what in uav.waiting_for() if what.startswith(f"{topics.EPOCH.name} at ")}

    others = [i for i in scenario.uav_ids if i != LEADER]
    ros.spin_until(
        lambda: missing_listeners() == {f"{topics.EPOCH.name} at uav{i}" for i in others}
    )
    for i in others:
        ends = Endpoints(ros.node("controller", namespace=f"/uav{i}"), False)
        ends.listen(topics.EPOCH, bytes, lambda _: None)
    ros.spin_until(lambda: not missing_listeners())


def test_no_flight_begins_by_clocks_that_differ(ros, scenario):
    others = Others(ros, scenario, LEADER, lockstep=False)

    def told():
        others.odom(time.time_ns() - int(0.3e9))
        return any("another time" in what for what in others.uav.waiting_for())

    ros.spin_until(told)
    refused = call(ros, others.node, "start")
    assert not refused.success
    assert f"s ahead of /uav{LEADER}/odom" in refused.message


def test_real_time_setpoints_end_with_the_odometry(ros, scenario):
    others = Others(ros, scenario, LEADER, lockstep=False)
    others.odom(time.time_ns() - int(0.4e9))  # of 0.5 s
    ros.spin_until(lambda: others.wrenches)
    ros.spin_until(lambda: "stale" in others.newest()[1])
    count = len(others.wrenches)
    others.settle()
    assert len(others.wrenches) == count
    level, _, told = others.newest()
    assert (level, told["safety"]) == (b"\x02", "stop")


def test_real_time_a_follower_whose_parent_is_silent_says_that_it_holds_and_goes_on(ros, scenario):
    others = Others(ros, scenario, FOLLOWER, lockstep=False)
    others.form(time.time_ns())

    def told(state, *senders):
        now_ns = time.time_ns()
        others.odom(now_ns)
        others.neighbours(now_ns, without={PARENT, LEADER, *NEIGHBOURS} - set(senders))
        newest = others.status[-1] if others.status else (b"", "", {})
        return newest[2].get("safety") == state

    everybody = (PARENT, LEADER, *NEIGHBOURS)
    ros.spin_until(lambda: told("degraded", *everybody))  # there is no near-object sensor
    ros.spin_until(lambda: told("hold clear", LEADER))
    assert others.status[-1][1].startswith("holding; ")
    assert "estimates left out: uav2 uav4" in others.status[-1][1]
    ros.spin_until(lambda: told("degraded", *everybody))


def test_real_time_ticks_go_on_after_legs_in_a_row(ros, scenario):
    """A hold and a start 4 ms apart once stopped them for good; so did the legs of a flight, read by a late UAV."""
    others = Others(ros, scenario, FOLLOWER, lockstep=False)
    others.odom(time.time_ns())
    ros.spin_until(lambda: others.wrenches)
    now = time.time_ns()
    for number, leg in enumerate(("form", "hold", "form", "hold", "form")):
        others.form(now + number * 4_000_000, leg)
        others.form(now + number * 4_000_000, leg)  # and again
        ros.spin_for(0.004)
    count = len(others.wrenches)

    def flies_on():
        others.odom(time.time_ns())
        return len(others.wrenches) > count + 20

    ros.spin_until(flies_on)


BROKEN = {
    "nan": np.nan,
    "inf": np.inf,
    "huge": 1e308,
}


@pytest.mark.parametrize("value", BROKEN.values(), ids=BROKEN)
def test_a_broken_state_of_a_neighbour_is_dropped_and_named(ros, scenario, value):
    """One such number once poisoned a follower for the rest of its flight, in silence."""
    others = Others(ros, scenario, FOLLOWER)
    others.form()
    others.odom(0)
    others.near(0)
    ros.spin_until(lambda: others.ticks() == [0])
    values = body(LEADER)
    values[0] = value
    template = wire.OdometryTemplate("map", f"uav{LEADER}/base_link")
    others.send_state[LEADER](template.encode(0, values))
    others.odom(scenario.dt_ns)
    others.neighbours(0)
    ros.spin_until(lambda: others.ticks() == [0, 1])
    assert np.isfinite(others.wrenches[-1].values).all()
    # The status after the refusal warns, those after it only count.
    ros.spin_until(lambda: any(told.get("refused") for _, _, told in others.status))
    level, message, told = next(one for one in others.status if one[2].get("refused"))
    assert (level, told["refused"]) == (b"\x01", f"/uav{LEADER}/formation_state=1")
    assert "1 messages refused: /uav1/formation_state: nav_msgs/Odometry: position" in message


def test_no_message_ends_a_uav(ros, scenario):
    """Each of these once raised in a callback, and the process ended."""
    others = Others(ros, scenario, FOLLOWER, lockstep=False)
    others.announce(wire.HeaderTemplate("dance").encode(0))
    others.lose(wire.HeaderTemplate("uav" + 5000 * "9").encode(0))
    no_radius = wire.encode_near(0, "map", np.ones((1, 7))).replace(b"radius\0", b"raddus\0")
    others.send_near(no_radius)
    others.send_odom(b"\0\1\0\0")
    others.send_state[LEADER](b"")

    def all_named():
        return len(others.newest()[2].get("refused", "").split()) == 5

    ros.spin_until(all_named)
    others.odom(time.time_ns())
    ros.spin_until(lambda: others.wrenches)


def test_a_uav_whose_vehicle_is_gone_for_good_ends(ros, scenario):
    """A process that was started again by hand once outlived its flight."""
    ended = []
    edges = CommunicationGraph(scenario, FlightOptions())
    node = ros.node("controller", namespace=f"/uav{FOLLOWER}")
    uav = UavNode(node, scenario, FOLLOWER, edges, lambda: ended.append(True))
    uav.look_for_vehicle(1e6)  # its vehicle has not come yet
    vehicle = ros.node("vehicle")
    Endpoints(vehicle, False).publisher(topics.odom(FOLLOWER), 1)
    ros.spin_until(lambda: f"/uav{FOLLOWER}/odom" not in uav.endpoints.unheard())
    uav.look_for_vehicle(time.monotonic())
    ros.remove(vehicle)
    ros.spin_until(lambda: f"/uav{FOLLOWER}/odom" in uav.endpoints.unheard())
    uav.look_for_vehicle(time.monotonic() + 29.0)
    assert ended == []
    uav.look_for_vehicle(time.monotonic() + 31.0)
    assert ended


def sealed_uav(ros, scenario, uav_id):
    """A UAV of a fleet with a seal, and the ends of a node with the seal and of one without."""
    seal = Seal(bytes(32))
    edges = CommunicationGraph(scenario, FlightOptions(seal=seal))
    uav = UavNode(ros.node("controller", namespace=f"/uav{uav_id}"), scenario, uav_id, edges)
    return uav, Endpoints(ros.node("ours"), False, seal), Endpoints(ros.node("theirs"), False)


def test_with_a_seal_no_leg_of_an_outsider_counts(ros, scenario):
    uav, ours, theirs = sealed_uav(ros, scenario, FOLLOWER)
    leg = wire.HeaderTemplate("form").encode(7)
    true, forged = ours.publisher(topics.EPOCH, 1), theirs.publisher(topics.EPOCH, 1)
    ros.spin_until(lambda: not ours.unread() and not theirs.unread())
    forged(leg)
    ros.spin_until(lambda: uav.endpoints.refusals.counts)
    assert "not sealed with the key of the fleet" in uav.endpoints.refusals.newest
    assert not uav._epochs.announced
    true(leg)
    ros.spin_until(lambda: uav._epochs.announced)
    ros.spin_until(uav.endpoints.rivals)
    assert uav.endpoints.rivals().startswith("/formation/epoch has a second publisher: /")


def test_with_a_seal_the_leader_answers_no_call_without_a_sealed_request(ros, scenario):
    _, ours, theirs = sealed_uav(ros, scenario, LEADER)
    send = [ends.publisher(topics.REQUEST, 1) for ends in (ours, theirs)]
    ros.spin_until(lambda: not ours.unread() and not theirs.unread())
    node = ours._node
    refused = call(ros, node, "stop").message
    assert refused.startswith("security: signed: expected a sealed /formation/request")
    request = wire.HeaderTemplate("stop").encode(0)
    send[1](request)
    ros.spin_for(0.1)
    assert call(ros, node, "stop").message == refused
    send[0](request)
    ros.spin_for(0.1)
    assert call(ros, node, "stop").message == "not started: call /formation/start first"
    assert call(ros, node, "stop").message == refused  # one call for one request


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--scenario", "nowhere.yaml", "--uav", "1"], "nowhere.yaml"),
        (["--scenario", "paper_5", "--uav", "9"], "UAV 9: expected one of 1, 2, 3, 4, 5"),
        (["--scenario", "paper_5"], "--uav"),
        (["--scenario", "paper_5", "--uav", "x"], "invalid int value: 'x'"),
    ],
)
def test_a_users_error_is_one_line_and_exit_2(arguments, line, capsys):
    try:
        code = main.main(arguments)
    except SystemExit as exit:
        code = exit.code
    assert code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("uav: ")
    assert line in err
    assert err.count("\n") == 1


def test_leader_takes_words_on_the_legs_of_a_mission(ros):
    legs = [
        {"kind": "form", "over_s": 5},
        {"kind": "go_to", "name": "gate", "position_m": [2, 5, 6], "over_s": 4, "on": "word"},
        {"kind": "go_to", "name": "far", "position_m": [500, 5, 6], "over_s": 4, "on": "word"},
    ]
    others = Others(ros, load_scenario("paper_5_free", {"mission": {"legs": legs}}), LEADER)
    assert "call /formation/start first" in call(ros, others.node, "leg_2").message
    Endpoints(others.node, lockstep=True).listen(topics.EPOCH, bytes, lambda data: None)
    ros.spin_until(lambda: not others.uav.waiting_for())
    assert call(ros, others.node, "start").success
    others.odom(0)
    others.near(0)
    ros.spin_until(lambda: others.ticks() == [0])
    told = json.loads(call(ros, others.node, "mission").message)
    assert told["now_s"] == 0.0
    assert [(leg["name"], leg.get("begin_s")) for leg in told["legs"]] == [
        ("form-1", 0.0), ("gate", None), ("far", None),
    ]  # fmt: skip
    refused = call(ros, others.node, "leg_3")
    assert not refused.success
    assert refused.message.startswith("leg far leaves -")
    taken = call(ros, others.node, "leg_2")
    assert (taken.success, taken.message) == (True, "leg gate from 0.50 s, due at 4.50 s")
    ros.spin_until(lambda: others.epochs == [(0, "form"), (500_000_000, "mission 2")])
    told = json.loads(call(ros, others.node, "mission").message)
    assert told["legs"][1]["begin_s"] == 0.5


def test_a_mission_that_should_have_begun_is_not_started(ros):
    """In real time; one that is to begin later begins at that very instant."""
    legs = [{"kind": "form", "over_s": 5}]
    soon_s = round(time.time()) + 60
    for start_s, begins in ((soon_s - 120, False), (soon_s + 7200, False), (soon_s, True)):
        start = datetime.fromtimestamp(start_s, timezone.utc).isoformat().replace("+00:00", "Z")
        mission = {"mission": {"start": start, "legs": legs}}
        others = Others(ros, load_scenario("paper_5_free", mission), LEADER, lockstep=False)
        others.odom(time.time_ns())
        ros.spin_until(lambda others=others: others.wrenches)
        answer = call(ros, others.node, "start")
        assert answer.success == begins
        if begins:
            ros.spin_until(lambda others=others: others.epochs)
            assert others.epochs[0].stamp_ns == soon_s * 1_000_000_000
        else:
            assert "expected a time within the next 3600 s" in answer.message
        others.uav.close()


def test_who_leads_next_tells_the_legs_again(ros):
    """A UAV that is started after the leader's process has ended hears of the epoch from its successor."""
    relay = load_scenario("relay")
    others = Others(ros, relay, 2, lockstep=False)
    heard = []
    listener = Endpoints(ros.node("listener"), lockstep=False)
    listener.listen(topics.EPOCH, wire.decode_header, heard.append)
    epoch = wire.HeaderFields(time.time_ns(), "form")
    others.form(*epoch)

    def flown(*absent):
        others.odom(time.time_ns())
        others.neighbours(time.time_ns(), without=absent)

    def all_there():
        flown()
        return heard and others.newest()[2]["mode"] == "form"

    ros.spin_until(all_there)
    ros.spin_until(lambda: flown() or time.time_ns() > epoch.stamp_ns + 1_000_000_000)
    assert heard == [epoch]
    ros.spin_until(lambda: flown(1) or len(heard) == 2)
    assert heard == [epoch, epoch]
    assert "second publisher" not in others.newest()[1]
    assert call(ros, others.node, "hold").success
    ros.spin_until(lambda: flown(1) or others.newest()[2]["mode"] == "hold")
    assert [leg.frame_id for leg in heard] == ["form", "form", "hold"]


def test_a_leader_that_comes_back_serves_no_longer(ros):
    """Its successor does: a UAV that was away does not lead again."""
    others = Others(ros, load_scenario("relay"), LEADER, lockstep=False)
    hold = others.node.create_client(Trigger, "/formation/hold")
    ros.spin_until(hold.service_is_ready)
    told = Endpoints(ros.node("successor"), lockstep=False).publisher(topics.EPOCH, 1)
    told(wire.HeaderTemplate("form").encode(time.time_ns() - 10_000_000_000))

    def flown():
        others.odom(time.time_ns())
        others.neighbours(time.time_ns())

    ros.spin_until(lambda: flown() or not hold.service_is_ready())
