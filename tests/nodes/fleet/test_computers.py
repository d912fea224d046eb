"""A fleet on two computers (network namespaces), with the profiles that `ptnsbc network` writes."""

import json
import os
import signal

import pytest

from bench import namespaces

pytest.importorskip("rclpy")

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.skipif(namespaces.missing() is not None, reason=str(namespaces.missing())),
]

# State and wrench of a simulated vehicle travel too, which a real one keeps on board: with a fifth of them lost the
# attitude loop of the quadrotor has little to spare (docs/fleet.md), the paper's plant has.
FLIGHT = ("paper_5", "--json", "--plant", "rigid_body_6dof")


# Through a server Fast DDS does not introduce every process in about one of ten starts, with loss and without, and
# the launcher does not start such a process again yet (docs/fleet.md). PTNSBC_TEST_SERVER=1 flies it all the same.
SERVER = pytest.mark.skipif(
    "PTNSBC_TEST_SERVER" not in os.environ,
    reason="known defect: a discovery server leaves a process out in about one of ten starts; PTNSBC_TEST_SERVER=1",
)


@pytest.fixture(
    params=[("peers", 20), pytest.param(("server", 0), marks=SERVER)],
    ids=lambda param: f"{param[0]}, {param[1]} % lost",
)
def network(request):
    return request.param


@pytest.fixture
def pair(network):
    with namespaces.two_computers(network[1]) as made:
        yield made


@pytest.fixture
def profile(network, pair, tmp_path):
    """The file that both computers fly with."""
    ground, away = pair
    file = tmp_path / "fleet.xml"
    if network[0] == "peers":
        call = ground.ptnsbc("network", "peers", ground.address, away.address, "-o", file)
        assert namespaces.finished(call)[0] == 0
        yield file
        return
    call = ground.ptnsbc("network", "server", ground.address, "-o", file)
    assert namespaces.finished(call)[0] == 0
    server = ground.ptnsbc("network", "serve", ground.address)
    yield file
    server.send_signal(signal.SIGINT)
    namespaces.finished(server)


def fly(pair, domain, *words):
    """Three UAVs, sim and recorder on the first computer, two UAVs on the second."""
    ground, away = pair
    words = (*FLIGHT, "--domain", domain, *words)
    second = away.ptnsbc("fleet", *words, "--only", "4,5")
    first = ground.ptnsbc("fleet", *words, "--only", "recorder,sim,1,2,3")
    # A discovery server does not always introduce everybody; compiled and flown it is within 70 s.
    try:
        return tuple(namespaces.finished(one, patience_s=100) for one in (first, second))
    finally:
        second.kill()  # when the first has not ended: it would wait for it for ever


@pytest.mark.alone
def test_the_fleet_forms_by_its_deadline(pair, profile, domain):
    (code, out, err), (away_code, away_out, away_err) = fly(
        pair, domain, "--duration", 8, "--network", profile
    )
    assert (code, away_code) == (0, 0), f"{out}\n{err}\n{away_err}"
    verdict = json.loads(out)
    assert verdict["verdict"] == "met"
    assert len(verdict["uavs"]) == 5
    assert pair[1].packets_sent() > 1000  # it was the cable, and no other way
    assert "uav4, uav5: running" in away_err
    assert json.loads(away_out)["fleet"]["died"] == []


def test_nothing_leaves_the_host_unless_told(tmp_path, domain):
    """The cable is the way to everywhere, multicast too; with a profile the same flight uses it."""
    with namespaces.two_computers() as (alone, other):
        flight = ("fleet", *FLIGHT, "--domain", domain, "--lockstep", "--duration", 1)
        namespaces.finished(alone.ptnsbc(*flight))
        namespaces.finished(alone.ptnsbc("stop", "--domain", domain))
        assert alone.packets_sent() == 0
        file = tmp_path / "fleet.xml"
        call = alone.ptnsbc("network", "peers", alone.address, other.address, "-o", file)
        namespaces.finished(call)
        namespaces.finished(alone.ptnsbc("stop", "--domain", domain, PTNSBC_NETWORK=str(file)))
        assert alone.packets_sent() > 0
