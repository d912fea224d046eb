"""Words on the legs of a mission, as an operator says them to a fleet of processes with sealed messages."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("rclpy")

from ptnsbc_io import wire
from ptnsbc_io.bag import read_bag
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.seal import KEY_FILE, Seal, new_key, read_key
from ptnsbc_nodes.fleet.coordinator_node import Coordinator
from ptnsbc_sim.scenario import scenario_from_text
from ptnsbc_sim.scenario.mission.legs import CANCEL
from ptnsbc_tools.reading.bag_reader import read_recording
from ptnsbc_tools.replay.rerun import rerun

pytestmark = [pytest.mark.ros, pytest.mark.slow]

MISSION = """
extends: paper_5_free
timing: {duration_s: 120}
security: signed
leader: {trajectory: {kind: hover, position_m: [0, 5, 10]}}
mission:
  cancel_s: 2
  legs:
    - {kind: form, over_s: 5}
    - {kind: go_to, name: gate, position_m: [6, 5, 10], over_s: 80, on: word}
    - {kind: go_to, name: far, position_m: [900, 5, 10], over_s: 4, on: word}
"""


def test_an_operator_begins_and_cancels_legs_of_a_sealed_fleet(
    launch, ros, tmp_path, domain, monkeypatch
):
    """A leg that cannot be flown is refused, without a key nothing is heard, and the bag runs again."""
    key = tmp_path / "fleet.key"
    new_key(key)
    monkeypatch.setenv(KEY_FILE, str(key))
    (tmp_path / "mission.yaml").write_text(MISSION)
    flight = launch(
        "--scenario", str(tmp_path / "mission.yaml"), "--bag", str(tmp_path / "bag"), "--wait",
        domain=domain,
    )  # fmt: skip
    now = [0]
    seal = Seal(read_key(key), required=True)
    ends = Endpoints(ros.node("operator"), lockstep=True, seal=seal)
    ends.listen(topics.odom(1), wire.decode_odometry, lambda one: now.__setitem__(0, one.stamp_ns))

    def mission(*words: str) -> subprocess.CompletedProcess:
        command = [sys.executable, "-m", "ptnsbc_tools", "mission", *words]
        return subprocess.run(
            [*command, "--domain", str(domain)], capture_output=True, text=True, timeout=200
        )

    flight.wait_for("all are ready")
    assert now == [0]
    started = mission("start", "1")
    assert started.returncode == 0, started.stderr
    ros.spin_until(lambda: now[0] > 0, timeout=200.0)
    begun = mission("start", "gate")
    assert begun.returncode == 0, begun.stderr
    with Coordinator(domain, "asker", seal=seal) as leader:
        taken, why = leader.ask("leg_3", 60.0)
        assert not taken
        assert why.startswith("leg far leaves -")
        told = json.loads(leader.ask("mission", 60.0)[1])["legs"]
        assert "begin_s" in told[1], "the refused leg has not ended the one that is flown"
    with Coordinator(domain, "outsider") as outsider:
        unheard, why = outsider.ask("cancel", 60.0)
        assert not unheard
        assert why.startswith("security: signed: expected a sealed")
    cancelled = mission("cancel")
    assert cancelled.returncode == 0, cancelled.stderr
    after: list[int] = []  # stamps since the leader has the word: `cancel_s` is over after 2 s
    ends.listen(topics.odom(1), wire.decode_odometry, lambda one: after.append(one.stamp_ns))
    ros.spin_until(lambda: after and after[-1] > after[0] + 5_000_000_000, timeout=200.0)
    flight.process.send_signal(signal.SIGINT)
    assert flight.finish() == 130, "\n".join(flight.lines)

    recording = read_recording(tmp_path / "bag")
    words = recording.scenario.words
    assert [word.number for word in words] == [2, CANCEL]
    bag = read_bag(tmp_path / "bag")
    scenario = scenario_from_text(bag.attachment("scenario.yaml").decode())
    assert rerun(bag, scenario).verdict == "equal"
    rest_ns = recording.first_ns + round((words[1].at_s + 3.0) * 1e9)
    at = recording.odometry[1].at(np.array([rest_ns, recording.end_ns]), 3)
    assert np.linalg.norm(at[1] - at[0]) < 0.05, "at rest"
    assert at[1, 0] < 5.5, "not at the gate"
