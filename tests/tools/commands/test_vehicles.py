"""`ptnsbc tune`: what it prints, and the scenario that it writes; the flight is in tests/nodes/bridge/tuning."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("pymavlink")
pytest.importorskip("rclpy")

from ptnsbc_io.mavlink.autopilots import VelocityResponse
from ptnsbc_nodes.bridge import hover_test
from ptnsbc_nodes.bridge.hover_test import FrequencyPoint, Identified
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.cli import app

SLOW = VelocityResponse(2.0, 1.0, 0.5, 1.0, 2.0, (0.2, 0.28))
POINTS = (FrequencyPoint(0.25, complex(0.9 * np.exp(-0.5j))),)


@pytest.fixture
def flown(monkeypatch):
    """The requests for flights; each finds the same slow vehicle."""
    requests = []

    def fly(scenario, uav, key, log, *, allow_arming, box_m):
        requests.append((scenario, uav, key, allow_arming, box_m))
        return Identified(SLOW, 0.2, 0.02, POINTS)

    monkeypatch.setattr(hover_test, "fly_hover_test", fly)
    return requests


def run(*arguments):
    return CliRunner().invoke(app, ["tune", *map(str, arguments)])


def test_the_file_is_a_scenario_that_fits_the_vehicle(flown, tmp_path):
    path = tmp_path / "tuned.yaml"
    found = run("experiment_4", "--uav", 2, "--allow-arming", "-o", path, "--box", 2, "--json")
    assert found.exit_code == 0, found.output
    scenario, uav, _, allow_arming, box_m = flown[0]
    assert (uav, allow_arming, box_m) == (2, True, 2.0)
    assert scenario.gains.formation.kappa_1_s == 1.2  # as flown, not as simulated
    printed = json.loads(found.stdout)
    tuned = load_scenario(str(path)).bridged()
    assert tuned.gains.formation.kappa_1_s == printed["settings"]["kappa_1_s"] < 1.2
    assert tuned.vehicle_link(2).tilt_lag_s == pytest.approx(0.48)
    assert tuned.vehicle_link(2).velocity_loop_1_s == pytest.approx(2.0)
    assert tuned.vehicle_link(1).tilt_lag_s is None
    assert tuned.formation.task == "relative_position"


def test_a_second_vehicle_adds_to_the_file_of_the_first(flown, tmp_path):
    first, second = tmp_path / "one.yaml", tmp_path / "two.yaml"
    assert run("experiment_4", "--uav", 1, "-o", first).exit_code == 0
    assert run(first, "--uav", 2, "-o", second).exit_code == 0
    tuned = load_scenario(str(second)).bridged()
    assert (
        tuned.vehicle_link(1).tilt_lag_s == tuned.vehicle_link(2).tilt_lag_s == pytest.approx(0.48)
    )


def test_all_vehicles_of_the_kind(flown, tmp_path):
    path = tmp_path / "tuned.yaml"
    assert run("experiment_4", "--uav", 1, "--alike", "-o", path).exit_code == 0
    tuned = load_scenario(str(path))
    assert {tuned.vehicle_link(uav).tilt_lag_s for uav in tuned.uav_ids} == {0.48}


def test_an_existing_file_is_refused_before_the_flight(flown, tmp_path):
    path = tmp_path / "tuned.yaml"
    path.write_text("name: mine")
    found = run("experiment_4", "--uav", 1, "-o", path)
    assert found.exit_code == 2
    assert not flown
    assert path.read_text() == "name: mine"
    found = run(path, "--uav", 1, "-o", path, "--overwrite")
    assert found.exit_code == 2
