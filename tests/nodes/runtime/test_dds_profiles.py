"""Profiles of Fast DDS: what they say, and that a broken one is refused instead of being ignored."""

import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from ptnsbc_nodes.runtime import dds_profiles, environment
from ptnsbc_nodes.runtime.dds_profiles import NetworkError

TAG = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"


def texts(profile: str, *path: str) -> list[str]:
    steps = "/".join(TAG + step for step in path)
    return [element.text for element in ElementTree.fromstring(profile).iterfind(f".//{steps}")]


def test_on_one_host_nothing_but_loopback_is_used():
    profile = dds_profiles.localhost(20)
    assert texts(profile, "interfaceWhiteList", "address") == ["127.0.0.1"]
    assert texts(profile, "initialPeersList", "locator", "udpv4", "address") == ["127.0.0.1"]
    assert texts(profile, "maxInitialPeersRange") == ["20"]


def test_peers_are_looked_for_and_heard_and_nobody_else():
    profile = dds_profiles.static_peers(["10.0.0.7", "10.0.0.8", "10.0.0.7"], 12)
    hosts = ["127.0.0.1", "10.0.0.7", "10.0.0.8"]
    assert texts(profile, "initialPeersList", "locator", "udpv4", "address") == hosts
    assert texts(profile, "interfaceWhiteList", "address") == hosts
    assert texts(profile, "maxInitialPeersRange") == ["12"]


@pytest.mark.parametrize(
    "profile",
    [
        dds_profiles.localhost(3),
        dds_profiles.static_peers(["10.0.0.7"]),
    ],
)
def test_profiles_fit_the_schema_of_fast_dds(profile):
    etree = pytest.importorskip("lxml.etree")
    found = [
        path
        for prefix in (sys.prefix, "/opt/ros/jazzy")
        for path in Path(prefix).glob("share/**/fastRTPS_profiles.xsd")
    ]
    if not found:
        pytest.skip("this ROS installation has no fastRTPS_profiles.xsd")
    schema = etree.XMLSchema(etree.parse(found[0]))
    schema.assertValid(etree.fromstring(profile.encode()))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: dds_profiles.static_peers([]), "no computer named"),
        (
            lambda: dds_profiles.static_peers(["10.0.0.1"], 0),
            "0 processes on each computer: expected 1",
        ),
        (lambda: dds_profiles.static_peers(["10.0.0.1"], 121), "expected 1 to 120"),
        (
            lambda: dds_profiles.static_peers(["nowhere.invalid"]),
            "'nowhere.invalid': .*IPv4 address",
        ),
    ],
)
def test_what_cannot_be_reached_is_refused(call, words):
    with pytest.raises(NetworkError, match=words):
        call()


def test_names_are_resolved():
    assert dds_profiles.resolved("localhost") == "127.0.0.1"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "No such file"),
        ("<dds>", "no element found.*: expected a profile"),
        ("<dds><profiles/></dds>", "no <participant>"),
    ],
)
def test_a_profile_that_fast_dds_would_pass_over_is_refused(tmp_path, text, words):
    profile = tmp_path / "fleet.xml"
    if text is not None:
        profile.write_text(text)
    with pytest.raises(NetworkError, match=words):
        dds_profiles.checked(profile)


@pytest.fixture
def joined(monkeypatch, tmp_path):
    """The settings of this process after it has been told to fly over a network."""
    profile = tmp_path / "fleet.xml"
    profile.write_text(dds_profiles.static_peers(["10.0.0.7"]))
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "RMW_IMPLEMENTATION"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv(environment.NETWORK, str(profile))
    return profile


def test_the_switch_to_a_network_wins_over_localhost(joined, tmp_path):
    settings = environment.for_children(5, 8, tmp_path)
    assert settings["FASTRTPS_DEFAULT_PROFILES_FILE"] == str(joined)
    assert settings["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"
    assert not (tmp_path / "discovery.xml").exists()


def test_another_middleware_would_not_read_the_profile(joined, monkeypatch):
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    with pytest.raises(NetworkError, match="RMW_IMPLEMENTATION=rmw_cyclonedds_cpp"):
        environment.prepare()
