"""docker/: what can be checked of it without a container engine, beside the linters of `make lint`."""

import re
import shlex
from pathlib import Path

import pytest
import yaml

from ptnsbc_nodes.runtime import environment
from ptnsbc_sim.scenario import load_scenario

ROOT = Path(__file__).resolve().parents[1]
DOCKER = ROOT / "docker"
VEHICLES = "--backend mavlink --allow-arming"


def interpolated(text: str, **given: str) -> str:
    """As compose fills in ${NAME:-default}."""
    return re.sub(r"\$\{(\w+):-(.*?)\}", lambda found: given.get(found[1]) or found[2], text)


@pytest.fixture(scope="module")
def compose():
    return yaml.safe_load((DOCKER / "compose.yaml").read_text())


def commands(compose, profile: str, **given: str) -> dict[str, list[str]]:
    """The command of every service that is started with this profile."""
    return {
        name: shlex.split(interpolated(service["command"], **given))
        for name, service in compose["services"].items()
        if profile in service.get("profiles", [profile])
    }


@pytest.mark.parametrize(
    ("profile", "backend", "given"),
    [("sim", "sim", {}), ("bridge", "mavlink", {"VEHICLES": VEHICLES})],
)
def test_every_process_of_the_fleet_has_one_container(compose, profile, backend, given):
    crew = pytest.importorskip("ptnsbc_nodes.fleet.child_process")
    scenario = load_scenario("paper_5")
    run = commands(compose, profile, **given)
    assert sorted(run) == sorted(crew.names(scenario, backend))
    for name, words in run.items():
        assert words[:3] == ["ptnsbc", "fleet", "paper_5"]
        only = words[words.index("--only") + 1]
        assert crew.chosen(only, scenario, backend) == {name}
        if backend == "mavlink":
            assert shlex.join(words[-3:]) == VEHICLES
    assert run["recorder"].count("--bag") == 1


def test_the_command_line_takes_what_the_containers_say(compose):
    from typer.testing import CliRunner

    from ptnsbc_tools.cli import app

    for profile, vehicles in (("sim", ""), ("bridge", VEHICLES)):
        for _, *words in commands(compose, profile, VEHICLES=vehicles).values():
            # A scenario that is not there is the first thing that is refused once all options are understood.
            asked = CliRunner().invoke(app, ["nowhere" if w == "paper_5" else w for w in words])
            assert asked.exit_code == 2
            assert "nowhere" in asked.stderr and "No such option" not in asked.stderr


def test_the_containers_may_have_the_priority_that_bridges_ask_for(compose):
    asked = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(environment, "_schedule", lambda _policy, priority: asked.append(priority))
        environment.prefer_punctuality()
    for service in compose["services"].values():
        assert service["ulimits"]["rtprio"] >= asked[0]


def test_every_container_is_healthy_by_what_its_own_process_reports(compose, monkeypatch):
    from typer.testing import CliRunner

    from ptnsbc_tools.cli import app
    from ptnsbc_tools.commands import flying_fleet

    asked = []
    monkeypatch.setattr(flying_fleet, "_health", lambda *about: asked.append(about) or 0)
    for name, service in compose["services"].items():
        run, entrypoint, *words = service["healthcheck"]["test"]
        assert (run, entrypoint, words[0]) == ("CMD", "entrypoint.sh", "ptnsbc")
        environment = service["environment"]
        assert CliRunner().invoke(app, words[1:], env=environment).exit_code == 0
        assert asked[-1] == (int(environment["ROS_DOMAIN_ID"]), "", [name])


def test_every_container_looks_for_every_other_one(compose):
    addresses = [
        service["networks"]["fleet"]["ipv4_address"] for service in compose["services"].values()
    ]
    assert len(set(addresses)) == len(addresses)
    for service in compose["services"].values():
        assert service["environment"]["ROS_STATIC_PEERS"].split(";") == addresses


def test_what_the_image_copies_is_there():
    sent = [
        line.removeprefix("!")
        for line in (ROOT / ".dockerignore").read_text().splitlines()
        if line.startswith("!")
    ]
    assert [path for path in sent if not (ROOT / path).exists()] == []
    text = (DOCKER / "Dockerfile").read_text()
    assert "COPY --chmod=755 docker/entrypoint.sh" in text and "docker/entrypoint.sh" in sent
    assert {"pyproject.toml", "requirements/apt/runtime.lock", "ros2_ws/src", "scenarios"} <= set(
        sent
    )


def test_the_base_image_is_named_by_its_digest():
    text = (DOCKER / "Dockerfile").read_text()
    assert re.search(r"^ARG BASE=ros:jazzy-ros-base-noble@sha256:[0-9a-f]{64}$", text, re.M)
    assert re.search(r"--require-hashes \\\n +-r requirements/apt/runtime.lock ", text)


def test_the_image_runs_as_somebody_and_what_it_runs_is_installed():
    text = (DOCKER / "Dockerfile").read_text()
    assert re.findall(r"^USER (.+)$", text, re.M) == ["10001"]
    assert re.search(r"^\[project.scripts\]\nptnsbc =", (ROOT / "pyproject.toml").read_text(), re.M)
    assert re.search(r'^CMD \["ptnsbc", "--help"\]$', text, re.M)
