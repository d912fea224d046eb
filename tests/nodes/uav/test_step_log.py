"""Notes of real time: what they name is what comes out, and a controller goes on from a snapshot bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from ptnsbc_core.types import MODE_FORMATION
from ptnsbc_io.wire import Stamped, WireError, decode_floats, decode_integers
from ptnsbc_nodes.comm.graph import CommunicationGraph, FlightOptions, Senders
from ptnsbc_nodes.uav import step_log
from ptnsbc_nodes.uav.inbox import NO_CUTOFF_NS
from ptnsbc_nodes.uav.uav_controller import StepTime, UavController
from ptnsbc_sim.scenario import load_scenario

SENDERS = Senders(parent=2, leader=1, estimators=(2, 4))
STEP_NS = 10_000_000


def odometry(rng: np.random.Generator, stamp_ns: int) -> Stamped:
    values = rng.normal(size=13)
    values[3:7] = (0.0, 0.0, 0.0, 1.0)
    return Stamped(stamp_ns, values)


def fed(controller: UavController, rng: np.random.Generator, k: int) -> StepTime:
    """A controller that has heard everybody before step `k`, and that step."""
    now_ns = (k + 1) * STEP_NS
    controller.inbox.own = odometry(rng, now_ns - 1)
    controller.inbox.near = Stamped(now_ns - 2, rng.normal(size=(2, 8)))
    for uav in SENDERS.states:
        controller.inbox.state_queues[uav].put(odometry(rng, now_ns - 3))
    for uav in SENDERS.estimators:
        controller.inbox.estimate_queues[uav].put(odometry(rng, now_ns - 4))
    return StepTime(now_ns, STEP_NS, MODE_FORMATION, STEP_NS, STEP_NS, True)


def controller() -> UavController:
    scenario = load_scenario("paper_5_free")
    made = UavController(scenario, 3, CommunicationGraph(scenario, FlightOptions()))
    made.inbox.listen_to(SENDERS)
    return made


def test_a_tick_names_its_inputs():
    flown, rng = controller(), np.random.default_rng(1)
    at = fed(flown, rng, 0)
    flown.inbox.near = None
    held = flown.inbox.held(NO_CUTOFF_NS, NO_CUTOFF_NS)
    label, numbers = decode_integers(step_log.TickTemplate(SENDERS).encode(7, at, held))
    note = step_log.tick_note(label, numbers.tolist())
    assert (note.sequence, note.moment) == (7, at)
    assert list(note.used) == ["own", "state1", "state2", "estimate2", "estimate4"]
    for source, message in zip(step_log.sources(SENDERS), held, strict=True):
        if message is not None:
            used = note.used[source]
            assert used == (message.stamp_ns, step_log.checksum(message))
            changed = message.values.copy()
            changed.reshape(-1).view(np.uint8)[5] ^= 1
            assert used.checksum != step_log.checksum(Stamped(message.stamp_ns, changed))


@pytest.mark.slow
def test_a_controller_continues_from_a_snapshot():
    first, rng = controller(), np.random.default_rng(2)
    for k in range(5):
        first.step(fed(first, rng, k), NO_CUTOFF_NS)
    data = step_log.SnapshotTemplate(first).encode(4, first)
    second = controller()
    label, numbers = decode_floats(data)
    assert "counters:" in label
    memory = step_log.decode_snapshot(label, numbers, like=first.state)
    old = step_log.decode_snapshot(label.replace("counters:", "tally:"), numbers, like=first.state)
    assert old.counters.tobytes() == memory.counters.tobytes()  # older bags stay readable
    assert memory.sequence == 4
    assert memory.limits == first.limits
    second.resume(memory.state, memory.counters, memory.memory)
    states = [np.random.default_rng(3), np.random.default_rng(3)]
    for k in range(5, 8):
        flown, again = (
            one.step(fed(one, rng, k), NO_CUTOFF_NS)
            for one, rng in zip((first, second), states, strict=True)
        )
        assert flown.vector.tobytes() == again.vector.tobytes()
    assert first.counters.values() == second.counters.values()


@pytest.mark.parametrize("label", ["", "sequence now_ns", "own own_checksum"])
def test_foreign_notes_are_refused(label):
    with pytest.raises(WireError, match="expected sequence now_ns"):
        step_log.tick_note(label, [0] * len(label.split()))
