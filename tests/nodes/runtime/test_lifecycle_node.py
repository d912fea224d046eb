"""The life cycle of a UAV node, its names in the graph, and what becomes of a bad request."""

import contextlib
import time

import numpy as np
import pytest
from own_services import LIFECYCLE, PARAMETERS

pytest.importorskip("rclpy")

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.task import Future

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io import wire
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints, fleet_namespace
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions
from ptnsbc_nodes.fleet import fleet_node as manager_module
from ptnsbc_nodes.fleet.fleet_node import LifecycleManager
from ptnsbc_nodes.runtime.lifecycle_node import ManagedNode
from ptnsbc_nodes.uav.uav_node import UavNode
from ptnsbc_sim.scenario import load_scenario

pytestmark = pytest.mark.ros

FOLLOWER, LEADER = 3, 1
CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
DEACTIVATE, CLEANUP = Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP
SHUTDOWN = Transition.TRANSITION_ACTIVE_SHUTDOWN


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("paper_5")


@pytest.fixture
def managed(ros, scenario):
    """Makes the managed node of one UAV."""

    def make(uav_id=FOLLOWER, *, lockstep=False, namespace=None, cli_args=()):
        node = ManagedNode(
            "controller",
            namespace=f"/uav{uav_id}" if namespace is None else namespace,
            context=ros.context,
            enable_rosout=False,
            cli_args=["--ros-args", *cli_args],
        )
        ros.adopt(node)
        edges = CommunicationGraph(scenario, FlightOptions(lockstep=lockstep))
        node.ended = False
        node.assign(
            lambda: UavNode(node, scenario, uav_id, edges), lambda: setattr(node, "ended", True)
        )
        return node

    return make


class Operator:
    """Asks a node's services, as `ros2 lifecycle` does."""

    def __init__(self, ros, name):
        self.ros = ros
        self.node = ros.node("operator")
        self._change = self.node.create_client(ChangeState, f"{name}/change_state")
        self._state = self.node.create_client(GetState, f"{name}/get_state")

    def _call(self, client, request):
        self.ros.spin_until(client.service_is_ready)
        future = client.call_async(request)
        self.ros.spin_until(future.done)
        return future.result()

    def change(self, transition=0, label=""):
        request = ChangeState.Request()
        request.transition.id, request.transition.label = transition, label
        return self._call(self._change, request).success

    def state(self):
        return self._call(self._state, GetState.Request()).current_state.label


def test_a_node_goes_through_its_states_and_back(ros, managed):
    node = managed()
    operator = Operator(ros, "/uav3/controller")
    before = {publisher.topic_name for publisher in node.publishers}
    seen = [operator.state()]
    for transition in (CONFIGURE, ACTIVATE, DEACTIVATE, CLEANUP):
        assert operator.change(transition)
        seen.append(operator.state())
    assert seen == ["unconfigured", "inactive", "active", "inactive", "unconfigured"]
    assert {publisher.topic_name for publisher in node.publishers} == before
    assert not list(node.subscriptions) and not list(node.timers)
    assert operator.change(CONFIGURE)
    assert operator.change(ACTIVATE)
    assert operator.change(label="shutdown")
    assert operator.state() == "finalized"
    assert node.ended


@pytest.mark.parametrize(
    "request_", [{"transition": ACTIVATE}, {"label": "deactivate"}, {"transition": 77}]
)
def test_a_transition_that_is_not_possible_is_refused(ros, managed, request_):
    managed()
    operator = Operator(ros, "/uav3/controller")
    assert not operator.change(**request_)
    assert operator.state() == "unconfigured"
    assert operator.change(CONFIGURE)


def test_what_cannot_be_configured_stays_unconfigured(ros, managed):
    node = managed()

    def refuse():
        raise PtnsbcError("no such link")

    node.assign(refuse, lambda: None)
    operator = Operator(ros, "/uav3/controller")
    assert not operator.change(CONFIGURE)
    assert operator.state() == "unconfigured"
    assert str(node.refusal) == "no such link"
    with pytest.raises(PtnsbcError, match="no such link"):
        node.autostart()


def test_an_error_of_ours_ends_the_process(managed):
    node = managed()

    def fail():
        raise ZeroDivisionError

    node.assign(fail, lambda: setattr(node, "ended", True))
    assert node.trigger_configure() is TransitionCallbackReturn.ERROR
    assert node.broken and node.ended


def manager_of(node):
    manager = LifecycleManager(set())
    manager.join(node, "")
    return manager


def take_to_active(ros, manager, node):
    manager.manage("uav3", "/uav3/controller")

    def arrived():
        manager.look()
        return node.state == "active"

    ros.spin_until(arrived)
    assert manager.refused == []


def test_the_manager_takes_nodes_to_active(ros, managed):
    node = managed()
    take_to_active(ros, manager_of(ros.node("fleet")), node)


def test_the_manager_names_who_refuses(ros, managed):
    def refuse():
        raise PtnsbcError("no")

    managed().assign(refuse, lambda: None)
    manager = manager_of(ros.node("fleet"))
    manager.manage("uav3", "/uav3/controller")

    def refused():
        manager.look()
        return manager.refused == ["uav3"]

    ros.spin_until(refused)


class Unanswered:
    """A client whose requests arrive, and whose answers get lost: all of them, or those to some requests."""

    def __init__(self, client, lost):
        self._client, self._lost = client, lost

    def service_is_ready(self):
        return self._client.service_is_ready()

    def call_async(self, request):
        answer = self._client.call_async(request)
        return Future() if self._lost(request.transition.id) else answer


@pytest.mark.parametrize(
    "lost",
    [lambda _: True, lambda transition: transition == CONFIGURE, lambda t: t == ACTIVATE],
    ids=["all", "configure", "activate"],
)
def test_a_manager_that_gets_no_answer_goes_on(ros, managed, monkeypatch, lost):
    """As over a lossy network, where a discovery server never told the node who asks."""
    node, fleet = managed(), ros.node("fleet")
    make, destroy = fleet.create_client, fleet.destroy_client
    monkeypatch.setattr(fleet, "create_client", lambda *of: Unanswered(make(*of), lost))
    monkeypatch.setattr(fleet, "destroy_client", lambda client: destroy(client._client))
    monkeypatch.setattr(manager_module, "_TRANSITION_S", 0.05)
    manager = manager_of(fleet)
    take_to_active(ros, manager, node)
    manager._active.add("uav3")  # as it says itself on /diagnostics
    manager.look()
    assert manager._nodes == {}


@pytest.mark.slow
@pytest.mark.parametrize("answers", [True, False])
def test_a_node_that_is_held_is_configured_and_not_activated(ros, managed, monkeypatch, answers):
    """Also where no answer arrives, and the manager tries the other transition."""
    node, fleet = managed(), ros.node("fleet")
    requests = []
    if not answers:
        make, destroy = fleet.create_client, fleet.destroy_client

        def lost(transition):
            requests.append(transition)
            return True

        monkeypatch.setattr(fleet, "create_client", lambda *of: Unanswered(make(*of), lost))
        monkeypatch.setattr(fleet, "destroy_client", lambda client: destroy(client._client))
        monkeypatch.setattr(manager_module, "_TRANSITION_S", 0.05)
    manager = manager_of(fleet)
    manager.held.add("uav3")
    manager.manage("uav3", "/uav3/controller")

    def configured():
        manager.look()
        return node.state == "inactive" and (answers or len(requests) > 2)

    ros.spin_until(configured)
    for _ in range(20):
        manager.look()
        ros.spin_for(0.02)
    assert node.state == "inactive" and ACTIVATE not in requests
    manager.held.clear()
    ros.spin_until(lambda: manager.look() or node.state == "active")
    assert manager.refused == []


class Ear:
    """Real odometry for one UAV, and the wrenches it answers with."""

    def __init__(self, ros, uav_id):
        self.ends = Endpoints(ros.node("ear"), lockstep=False)
        self._send = self.ends.publisher(topics.odom(uav_id), 1)
        self.wrenches, self.status = [], []
        self.ends.listen(topics.wrench_setpoint(uav_id), bytes, self.wrenches.append)
        self.ends.listen(topics.DIAGNOSTICS, bytes, self.status.append)

    def odom(self, stamp_ns):
        body = np.zeros(13)
        body[6] = 1.0
        self._send(wire.OdometryTemplate("map", "x").encode(stamp_ns, body))


def test_an_inactive_node_sends_no_setpoints(ros, managed):
    node, ear = managed(), Ear(ros, FOLLOWER)
    node.trigger_configure()
    ros.spin_until(lambda: not ear.ends.unheard() and not ear.ends.unread())

    def flies():
        ear.odom(time.time_ns())
        return len(ear.wrenches) > 3

    def tells_inactive():
        ear.odom(time.time_ns())
        return any(b"inactive" in status for status in ear.status)

    ros.spin_until(tells_inactive)
    assert ear.wrenches == []
    node.trigger_activate()
    ros.spin_until(flies)
    node.trigger_deactivate()
    inactive_ns = time.time_ns()
    ear.status.clear()
    ros.spin_until(tells_inactive)
    assert all(wire.peek_stamp(data) < inactive_ns for data in ear.wrenches)
    ear.wrenches.clear()
    node.trigger_activate()
    ros.spin_until(flies)


LEGS = {f"/formation/{leg}" for leg in ("start", "hold", "land", "stop")}


def shows(ros, ask, node, expected):
    """The graph is told to itself as to others: not at once."""

    def names():
        return {name for name, _ in ask(*node)}

    with contextlib.suppress(TimeoutError):
        ros.spin_until(lambda: names() == expected)
    assert names() == expected


@pytest.mark.parametrize("uav_id", [LEADER, FOLLOWER])
@pytest.mark.parametrize("lockstep", [False, True])
def test_the_graph_shows_what_the_architecture_lists(ros, managed, uav_id, lockstep):
    node = managed(uav_id, lockstep=lockstep)
    node.trigger_configure()
    node.trigger_activate()
    me, here = ("controller", f"/uav{uav_id}"), f"/uav{uav_id}"
    says = {
        "setpoint/wrench", "setpoint/velocity", "formation_state", "leader_estimate", "robot_description",
        *(() if lockstep else ("tick", "snapshot")),
    }  # fmt: skip
    expected = {f"{here}/{name}" for name in says}
    expected |= {"/diagnostics", "/formation/ready", "/parameter_events"}
    expected |= {f"{here}/controller/transition_event"}
    expected |= {"/formation/epoch"} if uav_id == LEADER else set()
    shows(ros, node.get_publisher_names_and_types_by_node, me, expected)

    heard = {f"{here}/odom", f"{here}/near", "/formation/epoch", "/formation/lost"}
    heard |= {"/formation/request"} if uav_id == LEADER else set()
    if uav_id == FOLLOWER:  # its parent, the leader, and its neighbours in the estimator graph
        heard |= {"/uav2/formation_state", "/uav1/formation_state"}
        heard |= {"/uav2/leader_estimate", "/uav4/leader_estimate"}
    shows(ros, node.get_subscriber_names_and_types_by_node, me, heard)

    own = {f"{here}/controller/{name}" for name in LIFECYCLE | PARAMETERS}
    own |= {f"{here}/controller/get_type_description"}
    own |= LEGS if uav_id == LEADER else set()
    shows(ros, node.get_service_names_and_types_by_node, me, own)


@pytest.mark.parametrize(
    ("namespace", "fleet"),
    [("/", ""), ("/uav3", ""), ("/a", "/a"), ("/a/uav3", "/a"), ("/a/b/uav12", "/a/b")],
)
def test_names_are_relative_to_the_namespace_of_the_fleet(namespace, fleet):
    assert fleet_namespace(namespace) == fleet


def test_a_namespace_and_a_remapping_are_honoured(ros, managed):
    node = managed(
        LEADER, cli_args=["-r", "__ns:=/red/uav1", "-r", "odom:=/somewhere/else"], namespace=""
    )
    node.trigger_configure()
    said = {publisher.topic_name for publisher in node.publishers}
    heard = {subscription.topic_name for subscription in node.subscriptions}
    assert {"/red/uav1/setpoint/wrench", "/red/formation/epoch", "/red/diagnostics"} <= said
    assert {"/somewhere/else", "/red/uav1/near"} <= heard
    assert "/somewhere/else" in node.work.waiting_for()
    services = {service.srv_name for service in node.services}
    assert "/red/formation/start" in services


def test_simulated_time_ticks_with_the_clock(ros, managed):
    from rosgraph_msgs.msg import Clock

    node = managed(LEADER, cli_args=["-p", "use_sim_time:=true"])
    ear = Ear(ros, LEADER)
    clock = ros.node("clock").create_publisher(Clock, "/clock", 1)
    node.autostart()
    ros.spin_until(lambda: not ear.ends.unheard() and not ear.ends.unread())
    ros.spin_until(lambda: clock.get_subscription_count() > 0)
    ear.odom(5_000_000_000)
    ros.spin_for(0.1)
    assert ear.wrenches == []  # by the wall clock there would have been ten
    now = 5.0

    def ticked():
        nonlocal now
        now += 0.01
        message = Clock()
        message.clock.sec, message.clock.nanosec = int(now), round((now % 1) * 1e9)
        clock.publish(message)
        return len(ear.wrenches) >= 3

    ros.spin_until(ticked)
