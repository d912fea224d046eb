"""One UAV node, with everybody else played by the test."""

import time

import numpy as np
import pytest

pytest.importorskip("rclpy")

from uav_surroundings import FOLLOWER, LEADER, NEIGHBOURS, PARENT, Others, body, call

from ptnsbc_core.step import initial_state, step
from ptnsbc_core.types import NEVER_RECEIVED_S, AgentInputs
from ptnsbc_io import wire
from ptnsbc_sim.scenario import agent_config, load_scenario

pytestmark = pytest.mark.ros

OWN_LAW = """
def mine(inputs):
    # towards the parent, from where it is heard
    return 0.1 * (inputs.positions[1] - inputs.position)
"""
CHILD = 4
WANTED = 0.1 * (body(PARENT) - body(FOLLOWER))[:3]


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("paper_5")


def test_lockstep_tick_waits_for_all_it_needs(ros, scenario):
    others = Others(ros, scenario, FOLLOWER)
    dt = scenario.timing.dt_ns
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
    dt_ns = scenario.timing.dt_ns
    rows = [[1.0, 2.0, 3.0, 0.5, 0.0, 0.25, 0.0, 1.5]]
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


def test_real_time_hovers_before_the_epoch_and_flies_after_it(ros, scenario):
    others = Others(ros, scenario, LEADER, lockstep=False)
    assert f"/uav{LEADER}/odom" in others.newest()[2]["waiting_for"]
    others.fly(ros)
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


def test_real_time_setpoints_end_with_the_odometry(ros, scenario):
    others = Others(ros, scenario, LEADER, lockstep=False)
    others.fly(ros)
    ros.spin_until(lambda: "stale" in others.newest()[1])
    count = len(others.wrenches)
    others.settle()
    assert len(others.wrenches) == count
    level, _, told = others.newest()
    assert (level, told["safety"]) == (b"\x02", "stop")


def test_real_time_ticks_go_on_after_legs_in_a_row(ros, scenario):
    """A hold and a start 4 ms apart once stopped them for good; so did the legs of a flight, read by a late UAV."""
    others = Others(ros, scenario, FOLLOWER, lockstep=False)
    others.fly(ros)
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


def test_no_message_ends_a_uav(ros, scenario):
    """Each of these once raised in a callback, and the process ended."""
    others = Others(ros, scenario, FOLLOWER, lockstep=False)
    others.announce(wire.HeaderTemplate("dance").encode(0))
    others.lose(wire.HeaderTemplate("uav" + 5000 * "9").encode(0))
    no_radius = wire.encode_near(0, "map", np.ones((1, 8))).replace(b"radius\0", b"raddus\0")
    others.send_near(no_radius)
    others.send_odom(b"\0\1\0\0")
    others.send_state[LEADER](b"")

    def all_named():
        return len(others.newest()[2].get("refused", "").split()) == 5

    ros.spin_until(all_named)
    others.fly(ros)


def test_in_real_time_a_follower_commands_what_its_law_gives(ros, tmp_path):
    (tmp_path / "mine.py").write_text(OWN_LAW, "utf-8")
    keys = {"law": f"{tmp_path}/mine.py:mine", "formation.avoidance": "off"}
    others = Others(ros, load_scenario("paper_5_free", keys), FOLLOWER, lockstep=False)
    assert sorted(others.send_state) == [LEADER, PARENT, CHILD]

    def commanded():
        """The newest velocity [m/s, ENU]; the body has no tilt and no heading."""
        now = time.time_ns()
        others.odom(now)
        others.neighbours(now)
        return others.states[-1].values[7:10] if others.states else np.full(3, np.nan)

    ros.spin_until(lambda: np.array_equal(commanded(), np.zeros(3)))  # before the epoch
    others.form(time.time_ns())
    ros.spin_until(lambda: np.allclose(commanded(), WANTED, atol=1e-6))
