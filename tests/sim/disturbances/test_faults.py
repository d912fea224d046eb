"""Injected faults in a headless flight, and the same faults message by message."""

import numpy as np
import pytest

from ptnsbc_core.agent import HOLDING
from ptnsbc_sim.disturbances.faults import message_faults
from ptnsbc_sim.disturbances.links import last_state_received, link_of
from ptnsbc_sim.disturbances.random_streams import STATE_LINK
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.recording import recording_of

MANY = [
    {"kind": "silence", "uav": 2, "at_s": 0.5, "duration_s": 0.3},
    {"kind": "loss", "uav": 2, "at_s": 1.0, "duration_s": 1.0, "share": 0.4},
    {"kind": "loss", "uav": 2, "at_s": 1.5, "duration_s": 1.0, "share": 0.4},
    {"kind": "delay", "uav": 2, "at_s": 1.2, "duration_s": 0.6, "delay_s": 0.083},
    {"kind": "nan", "uav": 2, "at_s": 2.7, "duration_s": 0.1},
    {"kind": "silence", "uav": 4, "at_s": 0.1},
]


def scenario(faults, seconds=3.0, **changes):
    return load_scenario(
        "paper_5_free", {"faults": faults, "timing.duration_s": seconds, **changes}
    )


def test_tables_and_single_messages_agree():
    one = scenario(MANY)
    link, faults = link_of(one, STATE_LINK, 3, 2), message_faults(one)
    lost = link.losses(one.timing.ticks, faults)
    stamps = one.timing.dt_ns * np.arange(one.timing.ticks)
    assert lost.tolist() == [link.loses(int(stamp), faults) for stamp in stamps]
    late = link.delays_ns(one.timing.ticks, faults)
    assert late.tolist() == [link.late_ns(int(stamp), faults) for stamp in stamps]
    share = lost[100:150].mean(), lost[150:200].mean()
    assert 0.2 < share[0] < 0.6 < share[1] + 0.15, "two losses at once lose 0.64"


def test_what_is_received_is_the_newest_that_has_arrived():
    one = scenario(MANY, **{"communication.delay_s": 0.02})
    link, faults = link_of(one, STATE_LINK, 3, 2), message_faults(one)
    received = last_state_received(one, 3, 2)
    for tick in range(one.timing.ticks):
        arrived = [
            sent
            for sent in range(tick)
            if not link.loses(sent * one.timing.dt_ns, faults)
            and sent * one.timing.dt_ns + link.late_ns(sent * one.timing.dt_ns, faults)
            <= tick * one.timing.dt_ns
        ]
        assert received[tick] == max(arrived, default=-1)


def test_a_link_without_faults_is_as_before():
    plain = load_scenario("paper_5_free", {"timing.duration_s": 3.0, "communication.loss": 0.2})
    faulty = scenario(MANY, **{"communication.loss": 0.2})
    assert last_state_received(faulty, 2, 1).tolist() == last_state_received(plain, 2, 1).tolist()


def test_seeds():
    loss = [{"kind": "loss", "uav": 1, "at_s": 0, "share": 0.5}]
    tables = [last_state_received(scenario(loss, seed=seed), 2, 1).tolist() for seed in (1, 1, 2)]
    assert tables[0] == tables[1] != tables[2]


@pytest.fixture(scope="module")
def silenced():
    return fly(scenario([{"kind": "silence", "uav": 2, "at_s": 1, "duration_s": 1}]))


def test_a_child_of_a_silent_uav_holds_after_stale_s_and_goes_on(silenced):
    holding = silenced.track.diagnostics[:, 2, HOLDING] > 0
    stale_s = float(silenced.scenario.communication.stale_s)
    hz = silenced.scenario.timing.control_hz
    # The newest message is one period older than the silence.
    assert np.flatnonzero(holding).tolist() == list(range(round((1 + stale_s) * hz), 2 * hz + 1))


def test_same_seed_same_bytes_with_faults_in_used_room_too(silenced):
    again = fly(silenced.scenario)
    kill = scenario([{"kind": "kill", "uav": 3, "at_s": 1}])
    first, second = fly(kill), fly(kill, room=again)
    for name in first.track._fields:
        a, b = getattr(first.track, name), getattr(second.track, name)
        assert a.tobytes() == b.tobytes(), name


def test_the_vehicle_of_a_killed_uav_stays_and_nothing_more_is_heard_of_it():
    flown = fly(scenario([{"kind": "kill", "uav": 3, "at_s": 1}], 7.0))
    places, row = flown.truth[:, :, :3], flown.scenario.uav_ids.index(3)
    assert np.ptp(places[100:, row], axis=0).max() == 0.0
    assert not flown.track.wrench[100:, row].any()
    recording = recording_of(flown)
    assert recording.wrench[3].last_ns == flown.t_ns[99]
    verdict = verdict_on(recording)
    assert verdict.faults == ("kill of uav3 at 1 s",)
    assert "UAV 3 silent" in verdict.uavs[row].reason


def test_a_jump_moves_what_the_uav_measures_and_not_the_uav():
    offset = [0.4, -0.2, 0.1]
    flown = fly(
        scenario([{"kind": "jump", "uav": 2, "at_s": 1, "duration_s": 0.5, "offset_m": offset}])
    )
    error = flown.track.odometry[:, 1, :3] - flown.truth[:, 1, :3]
    assert error[100:150] == pytest.approx(np.tile(offset, (50, 1)))
    assert not error[:100].any()
    assert not error[150:].any()
    others = np.delete(flown.track.odometry - flown.truth, 1, axis=1)
    assert not others.any()
