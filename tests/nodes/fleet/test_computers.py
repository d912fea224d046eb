"""A fleet on two and three computers (network namespaces), with static peers or a discovery server."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import namespaces
import pytest

pytest.importorskip("rclpy")

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.skipif(namespaces.missing() is not None, reason=str(namespaces.missing())),
]

# State and wrench of a simulated vehicle travel too, which a real one keeps on board: with a fifth of them lost the
# attitude loop of the quadrotor has little to spare (docs/fleet.md), the paper's plant has.
PLANT = ("--plant", "rigid_body_6dof")
SERVER = shutil.which(
    "fast-discovery-server", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}"
)
THREE = (str(Path(__file__).resolve().parents[3] / "examples" / "three.yaml"), *PLANT)


def fly(flight, parts, domain, *words, **settings):
    """Each computer with its processes; the last one leads. Exit code and what was said, in the same order."""
    running = [
        computer.ptnsbc(
            "fleet", *flight, "--json", "--domain", domain, *words, "--only", only, **settings
        )
        for computer, only in parts
    ]
    try:
        last = namespaces.finished(running[-1])
        return [*map(namespaces.finished, running[:-1]), last]
    finally:
        for process in running:  # those that follow would wait for ever for one that did not begin
            process.kill()


@pytest.mark.alone
def test_with_static_peers_and_a_fifth_of_the_packets_lost_the_fleet_forms_by_its_deadline(
    domain,
):
    with namespaces.computers(2, 20) as (ground, away):
        peers = f"{ground.address};{away.address}"
        parts = [(away, "3"), (ground, "recorder,sim,1,2")]
        (away_code, away_out, away_err), (code, out, err) = fly(
            THREE, parts, domain, ROS_STATIC_PEERS=peers
        )
        assert away.packets_sent() > 1000  # it was the cable, and no other way
    assert (code, away_code) == (0, 0), f"{out}\n{err}\n{away_err}"
    verdict = json.loads(out)
    assert verdict["verdict"] == "met"
    assert len(verdict["uavs"]) == 3
    assert "uav3: running" in away_err
    assert json.loads(away_out)["fleet"]["died"] == []


def test_through_a_discovery_server_every_flight_begins(domain):
    """A server leaves a process out in one of eight starts; the launcher starts that one again."""
    with namespaces.computers(3, 20) as (ground, second, third):
        server = subprocess.Popen(ground.inside(str(SERVER), "-i", "0", "-l", ground.address))
        settings = {
            "ROS_DISCOVERY_SERVER": ground.address,
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        }
        parts = [(second, "2"), (third, "3"), (ground, "recorder,sim,1")]
        ends = fly(THREE, parts, domain, "--duration", 2, **settings)
        server.kill()
    codes, told = [end[0] for end in ends], [json.loads(end[1]) for end in ends]
    assert codes == [0, 0, 1], ends  # two seconds are too short for the deadline
    assert [one["fleet"]["died"] for one in told] == [[], [], []]
    assert len(told[-1]["uavs"]) == 3


def test_nothing_leaves_the_host_unless_told(domain):
    """The cable is the way to everywhere, multicast too; with static peers a command uses it."""
    with namespaces.computers() as (alone, other):
        flight = ("fleet", *THREE, "--json", "--domain", domain, "--lockstep", "--duration", 1)
        namespaces.finished(alone.ptnsbc(*flight))
        namespaces.finished(alone.ptnsbc("stop", "--domain", domain))
        assert alone.packets_sent() == 0
        namespaces.finished(
            alone.ptnsbc("stop", "--domain", domain, ROS_STATIC_PEERS=other.address)
        )
        assert alone.packets_sent() > 0
