"""Flights with disturbances: one seed gives the same flight, headless and by the processes."""

from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from ptnsbc_core.agent import HOLDING, Agent
from ptnsbc_core.types import MODE_FORMATION, NEVER_RECEIVED_S, AgentInputs
from ptnsbc_sim.disturbances.links import Link, last_received, link_of
from ptnsbc_sim.disturbances.random_streams import ESTIMATE_LINK, STATE_LINK
from ptnsbc_sim.scenario import Scenario, agent_config, load_scenario
from ptnsbc_sim.swarm import HeadlessFlight, fly
from ptnsbc_sim.world import World

SHORT = 1.5


@lru_cache
def flight(seed: int = 1, seconds: float = SHORT) -> HeadlessFlight:
    changes = {"seed": seed, "timing.duration_s": seconds, "communication.loss": 0.2}
    return fly(load_scenario("experiment_4", changes))


LATE = {
    "delay_s": 0.035,
    "links": [
        {"sender": 1, "receiver": 3, "delay_s": 0.12},
        {"sender": 3, "receiver": 2, "delay_s": 0.0, "loss": 0.5},
    ],
}


def test_one_seed_gives_the_same_bytes_and_another_one_others() -> None:
    first, again, other = flight(1), fly(flight(1).scenario), flight(2)
    for a, b in zip(first.track, again.track, strict=True):
        assert a.tobytes() == b.tobytes()
    assert first.track.odometry[0].tobytes() != other.track.odometry[0].tobytes()
    assert first.truth[0].tobytes() == other.truth[0].tobytes()  # they start where the file says


def test_a_longer_flight_begins_with_the_shorter_one() -> None:
    shorter, longer = flight(1), flight(1, SHORT + 1.0)
    for a, b in zip(longer.track, shorter.track, strict=True):
        assert a[: len(b)].tobytes() == b.tobytes()


def test_where_nothing_is_left_to_chance_the_seed_does_not_matter() -> None:
    flights = [
        fly(load_scenario("experiment_4_calm", {"seed": seed, "timing.duration_s": 0.5}))
        for seed in (1, 2)
    ]
    for a, b in zip(flights[0].track, flights[1].track, strict=True):
        assert a.tobytes() == b.tobytes()
    assert flights[0].track.truth.size == 0
    assert flights[0].truth is flights[0].track.odometry


def received(scenario: Scenario, uav: int, tick: int, sent: int | None, estimate: bool) -> int:
    """Tick of the newest message that got through, as a UAV node finds it; -1: none."""
    if sent is None:
        return -1
    link = link_of(scenario, ESTIMATE_LINK if estimate else STATE_LINK, uav, sent)
    for before in range(tick - 1, -1, -1):
        in_time = (tick - before) * scenario.timing.dt_ns >= link.delay_ns
        if in_time and not link.loses(before * scenario.timing.dt_ns):
            return before
    return -1


def inputs(
    flown: HeadlessFlight, world: World, tick: int, uav: int, near: np.ndarray
) -> AgentInputs:
    """What the process of a UAV knows, from what others sent."""
    scenario, track = flown.scenario, flown.track
    rows = {other: row for row, other in enumerate(scenario.uav_ids)}

    def state(other: int | None) -> tuple[np.ndarray, float]:
        sent = received(scenario, uav, tick, other, False)
        if sent < 0 or other is None:
            return np.zeros(13), NEVER_RECEIVED_S
        age = ((tick - sent) * scenario.timing.dt_ns) * 1e-9
        return track.reported[sent, rows[other]].copy(), age

    others = scenario.topology.neighbours.get(uav, ())
    estimates, ages = np.zeros((len(others), 13)), np.full(len(others), NEVER_RECEIVED_S)
    for k, other in enumerate(others):
        sent = received(scenario, uav, tick, other, True)
        if sent >= 0:
            estimates[k] = track.estimate[sent, rows[other]]
            ages[k] = ((tick - sent) * scenario.timing.dt_ns) * 1e-9
    parent, parent_age = state(scenario.communication.parent(uav))
    leader, leader_age = state(scenario.leader.id if uav in scenario.topology.pinned else None)
    own, t = world.odometry(uav).copy(), (tick * scenario.timing.dt_ns) * 1e-9
    stale = (tick % scenario.near_every * scenario.timing.dt_ns) * 1e-9
    return AgentInputs(
        own, parent, parent_age, leader, leader_age, estimates, ages, near, stale, MODE_FORMATION, t
    )


@pytest.mark.parametrize("communication", [{}, LATE], ids=["lost", "lost and late"])
def test_world_and_agents_in_python_fly_the_same_flight(communication: dict[str, Any]) -> None:
    """The loop of the processes: sensors, wind, losses and delays one UAV at a time, and the same bits."""
    changes = {f"communication.{key}": value for key, value in communication.items()}
    changes |= {"timing.duration_s": SHORT, "seed": 1, "communication.loss": 0.2}
    flown = fly(load_scenario("experiment_4", changes))
    scenario, world = flown.scenario, World(flown.scenario)
    agents = {uav: Agent(agent_config(scenario, uav), world.odometry(uav)) for uav in world.ids}
    near = {}
    for tick in range(120):
        wrenches = {}
        for row, uav in enumerate(world.ids):
            assert world.odometry(uav).tobytes() == flown.track.odometry[tick, row].tobytes()
            assert world.truth(uav).tobytes() == flown.truth[tick, row].tobytes()
            if tick % scenario.near_every == 0:
                near[uav] = world.near(uav)
                assert near[uav].tobytes() == flown.near(tick, row).tobytes()
        t, dt = world.t_ns * 1e-9, scenario.timing.dt_ns * 1e-9
        for row, uav in enumerate(world.ids):
            out = agents[uav].step(inputs(flown, world, tick, uav, near[uav]), t, dt)
            assert out.wrench.tobytes() == flown.track.wrench[tick, row].tobytes(), (tick, uav)
            wrenches[uav] = out.wrench
        world.step(wrenches)


def test_who_sees_its_neighbours_is_not_off_by_their_errors() -> None:
    """Noise of the fixes alone: what is told is off by two errors, what is seen by none."""
    changes = {
        "timing.duration_s": 12.0,
        "world.gust_m_s": [0, 0, 0],
        "communication.loss": 0,
        "sensor.noise_m": 0,
        "sensor.velocity_noise_m_s": 0,
    }
    off = {}
    for sight_m in (0.0, 0.2):
        flown = fly(load_scenario("experiment_4", {**changes, "formation.sight_m": sight_m}))
        places = flown.truth[500:, :, :3]
        offsets = [flown.scenario.offset(uav) for uav in flown.scenario.followers]
        error = places[:, 1:] - places[:, :1] - np.array(offsets)
        off[sight_m] = np.sqrt(np.mean(np.sum(error**2, axis=2), axis=0))  # of 2, 3, 4
    assert (off[0.2] < 0.75 * off[0.0]).all(), off
    assert (off[0.2][1:] < 0.4 * off[0.0][1:]).all(), off


def test_as_many_messages_are_lost_as_asked_for_and_a_child_of_the_leader_hears_it_once() -> None:
    scenario = load_scenario("experiment_4", {"communication.loss": 0.05})
    heard = last_received(scenario, 2)
    ticks = np.arange(scenario.timing.ticks)[:, None]
    fresh = heard[1:, 1:, 1] == ticks[1:] - 1
    assert 1.0 - fresh.mean() == pytest.approx(0.05, abs=0.008)
    row = scenario.uav_ids.index(3)  # its parent is the leader
    np.testing.assert_array_equal(heard[:, row, 0], heard[:, row, 1])
    assert (heard[0] == -1).all()


@pytest.mark.parametrize(
    ("delay_s", "ticks"), [(0.0, 1), (0.01, 1), (0.0101, 2), (0.15, 15), (0.4, 40)]
)
def test_a_message_counts_when_its_delay_is_over(delay_s: float, ticks: int) -> None:
    """Of a tick it is one tick old at least; a rounded tick never counts early."""
    changes = {"communication.delay_s": delay_s, "timing.duration_s": 2.0}
    heard = last_received(load_scenario("paper_5", changes), 2)
    expected = np.maximum(np.arange(len(heard)) - ticks, -1)
    for row, column in ((1, 0), (4, 0), (2, 2)):
        np.testing.assert_array_equal(heard[:, row, column], expected)


def test_a_link_has_a_loss_and_a_delay_of_its_own() -> None:
    links = [
        {"sender": 2, "receiver": 3, "delay_s": 0.1},
        {"sender": 3, "receiver": 2, "loss": 0.5},
    ]
    scenario = load_scenario("experiment_4_calm", {"communication.links": links})
    assert scenario.communication.link(2, 3) == (0.0, 0.1)
    assert scenario.communication.link(3, 2) == (0.5, 0.0)
    assert scenario.communication.link(1, 2) == (0.0, 0.0)
    from_leader = link_of(scenario, STATE_LINK, 2, 1)
    assert not any(from_leader.loses(tick * scenario.timing.dt_ns) for tick in range(200))
    assert link_of(scenario, STATE_LINK, 3, 2).late_ns(0) == 100_000_000


def test_both_directions_of_a_link_lose_on_their_own() -> None:
    there, back = (
        Link(sender, 5 - sender, ESTIMATE_LINK, seed=1, loss=0.5, period_ns=10) for sender in (3, 2)
    )
    stamps = range(0, 20_000, 10)
    one = [there.loses(stamp) for stamp in stamps]
    other = [back.loses(stamp) for stamp in stamps]
    state = [there._replace(kind=STATE_LINK).loses(stamp) for stamp in stamps]
    for a, b in ((one, other), (one, state)):
        assert 0.4 < np.mean(np.array(a) == np.array(b)) < 0.6


def test_a_link_that_loses_almost_all_makes_a_follower_hold() -> None:
    """Half a second of silence is more than stale_s."""
    changes = {"communication.loss": 0.99, "timing.duration_s": 3.0}
    flown = fly(load_scenario("experiment_4", changes))
    assert flown.track.diagnostics[:, 1:, HOLDING].any()
    assert not flown.track.diagnostics[:, 0, HOLDING].any()


def test_the_experiment_meets_its_deadline_by_the_truth_and_nobody_comes_close() -> None:
    flown = fly(load_scenario("experiment_4", {"timing.duration_s": 12.0}))
    scenario, places = flown.scenario, flown.truth[:, :, :3]
    off = places[:, 1:] - places[:, :1]
    off -= np.array([scenario.offset(uav) for uav in scenario.followers])
    error = np.linalg.norm(off, axis=2)
    beside_leader_m = 0.05  # the tolerance has the leader's position fixes in it beside this
    assert beside_leader_m < scenario.formation.tolerance_m
    assert error[500].max() < beside_leader_m
    assert np.sqrt(np.mean(error[500:] ** 2, axis=0)).max() < 0.5 * beside_leader_m
    believed = np.linalg.norm(flown.track.odometry[500:, :, :3] - places[500:], axis=2)
    assert 0.01 < np.sqrt(np.mean(believed**2)) < 0.04
    for a in range(4):
        for b in range(a):
            assert np.linalg.norm(places[:, a] - places[:, b], axis=1).min() >= 0.5
