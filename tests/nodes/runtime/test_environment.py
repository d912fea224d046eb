"""The environment of the processes: ROS domains, discovery, scheduling, the end of the launcher."""

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from ptnsbc_nodes.runtime import environment, launcher
from ptnsbc_nodes.runtime.environment import DomainError, reserved_domain


@pytest.fixture
def no_domain(monkeypatch):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)


def test_two_fleets_get_two_domains(no_domain):
    with reserved_domain() as first, reserved_domain() as second:
        assert first != second
        assert {first, second} <= set(range(1, 102))


@pytest.fixture
def drawn_first(monkeypatch):
    """Have the next fleets try this domain first, then all others."""

    def patch(domain):
        monkeypatch.setattr(
            environment.random, "sample", lambda domains, _: sorted(domains, key=domain.__ne__)
        )

    return patch


def test_a_domain_of_the_tests_is_taken_by_no_fleet(no_domain, drawn_first, domain):
    """Not even between two tests, when no participant is there."""
    drawn_first(domain)
    with reserved_domain() as fleet:
        assert fleet != domain


def test_a_test_of_ros_and_a_fleet_leave_each_other_their_domains(no_domain, drawn_first):
    coordinator = pytest.importorskip("domain_coordinator")
    with coordinator.domain_id() as theirs:
        drawn_first(theirs)
        with reserved_domain() as fleet:
            assert fleet != theirs
            with coordinator.domain_id(iter([fleet, *range(1, 101)]).__next__) as next_theirs:
                assert next_theirs != fleet


def test_of_a_free_domain_the_user_need_not_say(monkeypatch):
    with environment.free_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        with environment.free_domain() as other:
            assert other != domain


def test_a_reserved_domain_in_which_processes_are_flies(no_domain):
    """A viewer looks there when no domain is named."""
    with reserved_domain() as domain:
        assert domain not in environment.flying_domains()  # nobody is there yet
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
            participant.bind(("", 7400 + 250 * domain + 10))
            assert domain in environment.flying_domains()
    assert domain not in environment.flying_domains()


def test_the_users_domain_wins(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    with reserved_domain() as domain:
        assert domain == 77


@pytest.mark.parametrize("domain", ["x", "-1", "233", "100000", "\u0663", "1" * 5000])
def test_a_users_domain_that_is_none_is_refused_before_the_middleware_sees_it(monkeypatch, domain):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    for begin in (environment.named_domain, environment.prepare):
        with pytest.raises(DomainError, match="expected a number from 0 to 232"):
            begin()
    with pytest.raises(DomainError, match=f"ROS_DOMAIN_ID={domain[:9]}"), reserved_domain():
        pass


def test_without_a_domain_it_is_that_of_ros(monkeypatch, no_domain):
    assert environment.named_domain() == 0
    monkeypatch.setenv("ROS_DOMAIN_ID", "")
    assert environment.named_domain() == 0


@pytest.fixture
def own_discovery(monkeypatch):
    for name in (
        "FASTRTPS_DEFAULT_PROFILES_FILE",
        "FASTDDS_DEFAULT_PROFILES_FILE",
        "ROS_DISCOVERY_SERVER",
        "ROS_STATIC_PEERS",
        "RMW_IMPLEMENTATION",
    ):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def test_children_probe_as_many_peers_as_there_are(own_discovery, tmp_path):
    settings = environment.for_children(5, 43, tmp_path)
    assert settings["ROS_DOMAIN_ID"] == "5"
    profile = Path(settings["FASTRTPS_DEFAULT_PROFILES_FILE"]).read_text()
    assert "<maxInitialPeersRange>55</maxInitialPeersRange>" in profile
    assert re.findall("<address>(.*?)</address>", profile) == ["127.0.0.1"] * 2


@pytest.mark.parametrize("reach", ["LOCALHOST", "SUBNET"])
def test_the_profile_of_children_fits_the_schema_of_fast_dds(
    own_discovery, monkeypatch, tmp_path, reach
):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", reach)
    etree = pytest.importorskip("lxml.etree")
    found = [
        path
        for prefix in (sys.prefix, "/opt/ros/jazzy")
        for path in Path(prefix).glob("share/**/fastRTPS_profiles.xsd")
    ]
    if not found:
        pytest.skip("this ROS installation has no fastRTPS_profiles.xsd")
    profile = environment.for_children(5, 3, tmp_path)["FASTRTPS_DEFAULT_PROFILES_FILE"]
    etree.XMLSchema(etree.parse(found[0])).assertValid(etree.parse(profile))


@pytest.mark.parametrize(
    ("name", "value"),
    [("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"), ("ROS_STATIC_PEERS", "10.0.0.7;10.0.0.8")],
)
def test_a_users_discovery_is_left_alone(own_discovery, monkeypatch, tmp_path, name, value):
    monkeypatch.setenv(name, value)
    settings = environment.for_children(5, 43, tmp_path)
    assert settings[name] == value
    assert settings["ROS_AUTOMATIC_DISCOVERY_RANGE"] != "SYSTEM_DEFAULT"
    profile = Path(settings["FASTRTPS_DEFAULT_PROFILES_FILE"]).read_text()
    assert "<participant" not in profile
    assert "<nanosec>20000000</nanosec>" in profile  # what is lost is asked for at once


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("RMW_IMPLEMENTATION", "rmw_of_nobody", "no such middleware"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", "would not find each other"),
        ("ROS_DISCOVERY_SERVER", "127.0.0.1:1", "nobody listens there"),
        (
            "ROS_DISCOVERY_SERVER",
            "127.0.0.1:x;no.host.of.this.name.invalid",
            "nobody listens there",
        ),
        ("ROS_STATIC_PEERS", "127.0.0.1;no.host.of.this.name.invalid", "is no known host"),
    ],
)
def test_variables_with_which_nobody_is_heard_are_refused_at_once(
    own_discovery, monkeypatch, tmp_path, name, value, why
):
    monkeypatch.setenv(name, value)
    with pytest.raises(environment.NetworkError, match=f"{name}={value}.*{why}"):
        environment.for_children(5, 43, tmp_path)


def test_a_discovery_server_that_listens_is_enough(own_discovery, monkeypatch, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        servers = f"127.0.0.1:1;127.0.0.1:{listener.getsockname()[1]}"
        monkeypatch.setenv("ROS_DISCOVERY_SERVER", servers)
        assert environment.for_children(5, 43, tmp_path)["ROS_DISCOVERY_SERVER"] == servers


def test_a_child_whose_launcher_has_gone_ends(monkeypatch):
    monkeypatch.setenv(launcher.PARENT, "1" if os.getppid() != 1 else "2")
    code = os.system(
        f"{sys.executable} -c 'from ptnsbc_nodes.runtime import environment as e; e.prepare()'"
    )
    assert os.waitstatus_to_exitcode(code) == 1


HURRY = """
import os, sys, threading
from ptnsbc_nodes.runtime import environment, launcher
waiting = threading.Event()
threading.Thread(target=waiting.wait, daemon=True).start()  # a node has threads before it knows whom it flies
assert environment.prefer_punctuality(after_vehicles="recorder" in sys.argv)
for thread in os.listdir("/proc/self/task"):
    print(os.sched_getscheduler(int(thread)), os.sched_getparam(int(thread)).sched_priority)
waiting.set()
"""


def _may_hurry():
    """Whether this host grants it: a control group may refuse it to root, too."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(2))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


@pytest.mark.skipif(not _may_hurry(), reason="no right to real-time scheduling here")
@pytest.mark.parametrize(("who", "priority"), [("uav", "2"), ("recorder", "1")])
def test_who_flies_runs_before_the_rest_with_all_its_threads(who, priority):
    root = Path(environment.__file__).parents[2]
    told = subprocess.run(
        [sys.executable, "-c", HURRY, who], capture_output=True, text=True, check=True, cwd=root
    )
    assert told.stdout.split() == [str(os.SCHED_RR), priority] * 2


def test_without_the_right_to_hurry_everything_goes_on(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert environment.prefer_punctuality() is False


@pytest.mark.parametrize("strategy", ["Enforce", "Permissive"])
def test_dds_security_without_a_middleware_that_has_it_is_refused(monkeypatch, strategy):
    monkeypatch.setattr(environment, "lacks_security", lambda: True)
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", strategy)
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    with pytest.raises(environment.DdsSecurityError, match="built without DDS Security"):
        environment.prepare()


def test_dds_security_of_another_ros_is_left_to_it(monkeypatch):
    monkeypatch.setattr(environment, "lacks_security", lambda: False)
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    environment.prepare()
