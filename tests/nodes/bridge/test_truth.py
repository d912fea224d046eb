"""Where a simulated vehicle really is, from the messages of the autopilots' simulations."""

import math

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from mavlink_fleet import MavlinkFleet

from ptnsbc_core.kinematics import rotation_from_quaternion, velocity_enu
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_nodes.bridge.truth import place_of, true_odometry
from ptnsbc_sim.scenario import load_scenario

AUTOPILOTS = {"px4": "px4", "arducopter": "ardupilot", "stm32": "generic"}
RESOLUTION_M = 0.02  # 1e-7 degrees are 11 mm


def fleet(kind, **overrides):
    changes = {"mavlink.autopilot": AUTOPILOTS[kind], **overrides}
    if kind == "stm32":
        changes["mavlink.setpoint"] = "attitude"
        settings = load_scenario("experiment_4").mavlink.overrides
        changes["mavlink.overrides"] = {**settings, "gains.force.kappa_1_s": 3.0}
    made = MavlinkFleet(
        load_scenario("experiment_4", changes).bridged(), kind, count=1, gnss="quiet"
    )
    return made.airborne()


@pytest.mark.parametrize("kind", ["px4", "arducopter"])
@pytest.mark.parametrize("height", ["ground", "origin"])
def test_the_truth_of_a_stand_in_is_in_the_world_of_the_fleet(kind, height):
    made = fleet(kind, **{"mavlink.height": height})
    made.form().run(3.0)
    uav = made.uavs[1]
    (_, first), (_, last) = uav.truths[0], uav.truths[-1]
    flight = uav.vehicle.flight
    # The leader defines the world: it stands at its start by its estimate. The moves are true.
    assert last[0:3] - first[0:3] == pytest.approx(
        flight.truth_enu - uav.vehicle.body.start_enu, abs=2 * RESOLUTION_M
    )
    estimated = uav.odometry[-1][0:3] if uav.odometry else uav.tracks[-1][1][0:3]
    assert np.linalg.norm(last[0:3] - estimated) < 1.0
    assert velocity_enu(last) == pytest.approx(flight.true_velocity_enu, abs=0.05)
    up = rotation_from_quaternion(last[3:7])[2, 2]
    assert up == pytest.approx(rotation_from_quaternion(flight._state[3:7])[2, 2], abs=0.01)


def test_a_controller_that_tells_no_truth_has_none():
    assert fleet("stm32").uavs[1].truths == []


def hil(**changes):
    fields = {
        "time_usec": 0,
        "attitude_quaternion": [1.0, 0.0, 0.0, 0.0],
        **dict.fromkeys(("rollspeed", "pitchspeed", "yawspeed"), 0.0),
        **dict.fromkeys(("lat", "lon", "alt", "vx", "vy", "vz"), 0),
        **dict.fromkeys(("ind_airspeed", "true_airspeed", "xacc", "yacc", "zacc"), 0),
    }
    return mavlink.MAVLink_hil_state_quaternion_message(**{**fields, **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {"attitude_quaternion": [0.0] * 4},
        {"attitude_quaternion": [math.nan, 0.0, 0.0, 1.0]},
        {"rollspeed": math.inf},
    ],
)
def test_numbers_without_sense_are_no_truth(changes):
    assert true_odometry(hil(**changes), np.zeros(3)) is None


def test_a_place_is_in_degrees_and_metres():
    place = place_of(hil(lat=473977420, lon=85455940, alt=488_500))
    assert place == pytest.approx((47.397742, 8.545594, 488.5))
