"""The procedure from the heartbeat to the take-off, and the orders of the operator: a vehicle of a few lines."""

import pytest

pytest.importorskip("pymavlink")

from procedure_flight import Flight

from ptnsbc_io.mavlink.autopilots import ARDUPILOT, PX4
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_nodes.bridge.procedure.steps import LIFTED_M, CommandRequest, Step, Stream


def test_the_formation_waits_until_the_vehicle_has_turned():
    flight = Flight().run(until=Step.AIRBORNE, unprepared="turning")
    flight.run(5.0)
    assert flight.procedure.awaited
    assert flight.procedure.awaited == "turning"
    flight.run(0.1, unprepared="")
    assert not flight.procedure.awaited
    assert flight.procedure.awaited == ""


@pytest.mark.parametrize("autopilot", [PX4, ARDUPILOT])
def test_from_heartbeat_to_disarmed(autopilot):
    flight = Flight(autopilot).flying()
    steps = list(dict.fromkeys(step for _, step, _ in flight.history))
    # steps that are over before they begin are passed within one call
    assert steps[-3:] == [Step.TAKEOFF, Step.AIRBORNE, Step.FLY]
    assert flight.history[-1][2].stream is Stream.PLANNER
    flight.run(until=Step.DONE, leg="land")
    assert flight.procedure.fault == ""
    requested = list(dict.fromkeys(flight.requested()))
    expected = [
        CommandRequest.OWN_MODE,
        CommandRequest.CHECK,
        CommandRequest.ARM,
        CommandRequest.TAKEOFF,
        CommandRequest.LAND,
    ]
    assert requested == [
        command
        for command in expected
        if command is not CommandRequest.TAKEOFF or autopilot is ARDUPILOT
    ]


def test_px4_receives_setpoints_for_more_than_a_second_before_offboard():
    flight = Flight().run(until=Step.ARM)
    began = next(t for t, _, output in flight.history if output.stream is Stream.HOLD)
    requested = next(
        t for t, _, output in flight.history if output.command is CommandRequest.OWN_MODE
    )
    assert requested - began > 1.0


def test_ardupilot_gets_no_setpoint_before_it_is_in_the_air():
    flight = Flight(ARDUPILOT).run(until=Step.TAKEOFF)
    assert flight.streams() == {Stream.NONE}
    assert CommandRequest.TAKEOFF in flight.run(until=Step.AIRBORNE).requested()


def test_nothing_is_armed_without_permission():
    flight = Flight(allow_arming=False).run(300.0)
    assert flight.step is Step.ARM
    assert CommandRequest.ARM not in flight.requested()
    # a pilot arms: still no take-off
    flight.run(10.0, armed=True)
    assert Stream.CLIMB not in flight.streams()
    # and flies it up by hand: then it is ours
    flight.run(until=Step.AIRBORNE, landed=False, height_m=5.0)
    flight.run(1.0)
    assert flight.history[-1][2].stream is Stream.HOLD


def test_an_armed_vehicle_on_the_ground_is_not_airborne_whatever_its_controller_says():
    by_hand = Flight(allow_arming=False).run(until=Step.ARM)
    by_hand.run(20.0, armed=True, landed=False, height_m=0.1)
    assert by_hand.step is Step.ARM
    assert by_hand.procedure.awaited
    by_hand.run(until=Step.AIRBORNE, height_m=LIFTED_M)
    flight = Flight().run(until=Step.READY, not_ready="bridge2")
    flight.run(until=Step.ARMED, not_armed="bridge2", armed=True, landed=False)
    flight.run(until=Step.TAKEOFF, not_armed="")


def test_a_vehicle_that_a_pilot_flies_keeps_its_mode():
    flight = Flight()
    flight.run(60.0, armed=True, landed=False, height_m=8.0, mode=FlightMode.OTHER)
    assert flight.step is Step.MODE
    assert flight.requested() == []
    flight.run(until=Step.AIRBORNE, mode=FlightMode.OWN)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"heartbeat_age_s": float("inf")}, "waiting for a heartbeat: not within 120 s"),
        ({"wrong_vehicle": "autopilot 8: expected px4"}, "autopilot 8: expected px4"),
        ({"parameters_read": False}, "reading parameters: not within 20 s"),
        ({"parameter_refusal": "GUID_OPTIONS=0"}, "GUID_OPTIONS=0"),
        ({"state_fault": "no GPS fix"}, "position: not within 120 s: no GPS fix"),
        ({"controller_age_s": 9.0}, "controller: not within 180 s: no fresh setpoints"),
        ({"controller_ready": False}, "controller: not within 180 s"),
        ({"duplicate_sysid": True}, "two vehicles with this system id"),
        ({"battery_low": "battery at 9 %"}, "not armed: battery at 9 %"),
        ({"fence_breach": "outside the geofence"}, "not armed: outside the geofence"),
    ],
)
def test_every_step_before_arming_has_a_limit_and_a_reason(changes, reason):
    flight = Flight().run(until=Step.FAILED, **changes)
    assert reason in flight.procedure.fault
    assert CommandRequest.ARM not in flight.requested()


def test_a_bridge_waits_for_a_controller_that_is_still_to_be_started_and_then_within_the_limit():
    flight = Flight().run(400.0, controller_absent=True, controller_ready=False)
    assert flight.procedure.step is Step.CONTROLLER
    flight.run(170.0, controller_absent=False)
    assert flight.procedure.step is Step.CONTROLLER
    flight.run(until=Step.FAILED)
    assert "controller: not within 180 s" in flight.procedure.fault


def test_a_mode_that_is_not_confirmed():
    flight = Flight()
    flight.ignored = {CommandRequest.OWN_MODE}
    flight.run(until=Step.FAILED, vehicle_warning="OFFBOARD: TEMPORARILY_REJECTED")
    assert "OFFBOARD not confirmed (OFFBOARD: TEMPORARILY_REJECTED)" in flight.procedure.fault
    assert flight.requested().count(CommandRequest.OWN_MODE) == pytest.approx(10, abs=1)


def test_arming_refused():
    flight = Flight()
    flight.ignored = {CommandRequest.ARM}
    flight.run(until=Step.FAILED, vehicle_warning="arm: DENIED, Compass not calibrated")
    assert "arming refused (arm: DENIED, Compass not calibrated)" in flight.procedure.fault
    assert flight.history[-1][2] == (Stream.NONE, None, False)


def test_a_vehicle_that_does_not_climb_is_disarmed():
    flight = Flight(ARDUPILOT)
    flight.ignored = {CommandRequest.TAKEOFF}
    flight.run(until=Step.DISARM).run(until=Step.FAILED)
    assert "taking off: not within 60 s: at 0.0 m of 3 m" in flight.procedure.fault
    assert not flight.snapshot.armed


def test_no_vehicle_is_ready_before_its_own_checks_pass():
    refused = {"unready": "its pre-arm check fails", "vehicle_warning": "not healthy: gps"}
    flight = Flight().run(until=Step.CHECKS, not_ready="bridge2").run(20.0, **refused)
    assert flight.step is Step.CHECKS
    assert CommandRequest.CHECK in flight.requested()
    flight.run(until=Step.READY, unready="").run(5.0)
    flight.run(until=Step.CHECKS, **refused)  # also while it waits for the others
    flight.run(until=Step.FAILED)
    assert flight.procedure.fault == (
        "waiting for its pre-arm checks: not within 30 s: its pre-arm check fails (not healthy: gps)"
    )
    assert CommandRequest.ARM not in flight.requested()


@pytest.mark.parametrize(
    ("change", "end"),
    [
        ({"stop_request": "land"}, Step.DONE),
        ({"stop_request": "kill"}, Step.FAILED),
        ({"controller_age_s": 1.0}, Step.FAILED),
        ({"state_fault": "GPS fix lost"}, Step.FAILED),
        ({}, Step.FAILED),  # its time is over
    ],
)
def test_an_order_to_arm_that_takes_effect_late_is_taken_back(change, end):
    """HEARTBEAT shows an arming up to a second later: the bridge had ended, and the rotors turned."""
    flight = Flight()
    flight.ignored = {CommandRequest.ARM}
    flight.run(until=Step.ARM).run(0.2).run(until=Step.DISARM, **change)
    flight.ignored = {CommandRequest.DISARM}
    flight.run(1.0, armed=True)
    flight.ignored = set()
    flight.run(until=end)
    assert not flight.snapshot.armed


@pytest.mark.parametrize(
    "change",
    [
        {"stop_request": "land"},
        {"hazard": "told by another bridge"},
        {"battery_low": "battery at 9 %"},
        {"controller_age_s": 9.0},
        {"mode": FlightMode.HOLD},  # by its failsafe, or a pilot's switch
    ],
)
def test_what_ends_a_take_off_on_the_ground_disarms_the_vehicle_there(change):
    flight = Flight()
    flight.run(until=Step.ARMED, not_armed="bridge2")
    flight.obeys = False
    flight.run(until=Step.TAKEOFF, not_armed="").run(until=Step.DISARM, **change)
    flight.run(2.6)
    assert CommandRequest.KILL in flight.requested()  # forced: it never left the ground
    in_the_air = Flight().run(until=Step.ARMED, not_armed="bridge2")
    in_the_air.obeys = False
    in_the_air.run(until=Step.TAKEOFF, not_armed="").run(1.0, height_m=2.0, landed=False)
    in_the_air.run(20.0, **change)
    assert CommandRequest.DISARM not in in_the_air.requested()


def test_a_bridge_that_starts_in_flight_never_forces_a_vehicle_of_which_it_does_not_know_the_ground():
    flight = Flight()
    flight.obeys = False
    flight.run(until=Step.ARMED, armed=True, mode=FlightMode.OWN, not_armed="bridge2")
    flight.run(until=Step.DISARM, companion_out="bridge2 failed").run(9.0)
    assert CommandRequest.KILL not in flight.requested()


def test_disarmed_again_before_it_took_off():
    flight = Flight(ARDUPILOT)
    flight.ignored = {CommandRequest.TAKEOFF}
    flight.run(until=Step.TAKEOFF).run(until=Step.FAILED, armed=False)
    assert "disarmed before it took off" in flight.procedure.fault


def test_position_lost_before_arming_goes_back_and_waits():
    flight = Flight().run(until=Step.STREAM).run(until=Step.STATE, state_fault="GPS fix lost")
    assert flight.history[-1][2].stream is Stream.NONE
    flight.run(until=Step.AIRBORNE, state_fault="")


def test_stop_lands_and_kill_disarms_in_the_air():
    flight = Flight().flying().run(until=Step.LAND, stop_request="land").run(until=Step.DONE)
    assert flight.procedure.fault == ""
    flight = Flight().flying().run(until=Step.FAILED, stop_request="kill")
    assert CommandRequest.KILL in flight.requested()
    assert "by the operator" in flight.procedure.fault
    assert not flight.snapshot.armed


def test_a_kill_is_repeated_until_the_motors_stand_still():
    flight = Flight().flying()
    flight.ignored = {CommandRequest.KILL}
    began = flight.snapshot.now_s
    flight.run(60.0, stop_request="kill")
    assert flight.step is Step.KILL
    assert flight.requested(began).count(CommandRequest.KILL) > 250
    # neither a landing of the fleet nor another order makes less of it
    flight.run(5.0, leg="land")
    assert flight.step is Step.KILL
    flight.ignored = set()
    flight.run(until=Step.FAILED)
    assert not flight.snapshot.armed


@pytest.mark.parametrize("step", [Step.TAKEOFF, Step.AIRBORNE, Step.FLY, Step.LAND])
def test_kill_in_every_step_of_the_flight(step):
    flight = Flight()
    if step is Step.TAKEOFF:
        flight.obeys = True
        flight.run(until=Step.ARM).run(until=Step.TAKEOFF)
    elif step is Step.AIRBORNE:
        flight.run(until=Step.AIRBORNE)
    else:
        flight.flying()
    if step is Step.LAND:
        flight.run(until=Step.LAND, stop_request="land")
    flight.run(0.2, stop_request="kill")
    assert CommandRequest.KILL in flight.requested()
    assert flight.step is Step.FAILED
    assert not flight.snapshot.armed


@pytest.mark.parametrize("request_", ["land", "kill"])
def test_a_vehicle_in_a_pilots_hands_is_left_alone_unless_all_are_meant(request_):
    flight = Flight().flying()
    flight.obeys = False
    flight.run(until=Step.YIELDED, mode=FlightMode.OTHER)
    taken = flight.snapshot.now_s
    flight.run(20.0, stop_request=request_)
    assert flight.step is Step.YIELDED
    assert flight.procedure.in_pilots_hands
    assert flight.requested(taken) == []
    flight.run(0.2, pilots_too=True)
    wanted = CommandRequest.KILL if request_ == "kill" else CommandRequest.LAND
    assert wanted in flight.requested(taken)


@pytest.mark.parametrize("request_", ["land", "kill"])
def test_a_bridge_that_starts_again_in_flight_obeys_the_order_that_holds(request_):
    flight = Flight()
    flight.run(
        5.0, armed=True, landed=False, height_m=8.0, mode=FlightMode.HOLD, stop_request=request_
    )
    wanted = CommandRequest.KILL if request_ == "kill" else CommandRequest.LAND
    assert wanted in flight.requested()
    by_hand = Flight()
    by_hand.run(5.0, armed=True, landed=False, mode=FlightMode.OTHER, stop_request=request_)
    assert by_hand.requested() == []


def test_a_vehicle_landed_past_its_bridge_is_no_pilots():
    flight = Flight().flying()
    flight.obeys = False
    flight.run(until=Step.LAND, mode=FlightMode.LAND, stop_request="land")


@pytest.mark.parametrize(("request_", "limit_s"), [("land", 10.0), ("kill", 30.0)])
def test_a_silent_vehicle_that_must_come_down_is_given_up_and_named(request_, limit_s):
    flight = Flight().flying()
    flight.obeys = False
    flight.run(1.0, heartbeat_age_s=5.0, state_fault="silent", controller_age_s=5.0)
    began = flight.snapshot.now_s
    left_behind = "armed at (1.0, 2.0, 8.0) m in OFFBOARD: without setpoints it hovers"
    flight.run(5.0, stop_request=request_, left_behind=left_behind)
    assert flight.step is (Step.KILL if request_ == "kill" else Step.LAND)
    flight.run(until=Step.FAILED, heartbeat_age_s=limit_s + 1.0)
    assert flight.snapshot.now_s - began < 15.0
    assert f"silent for {limit_s + 1.0:.0f} s" in flight.procedure.fault
    assert f"left behind {left_behind}" in flight.procedure.fault


def test_stop_before_arming_ends_it():
    assert (
        Flight().run(until=Step.STREAM).run(until=Step.DONE, stop_request="land").procedure.fault
        == ""
    )


def test_no_vehicle_arms_before_all_are_ready_and_none_climbs_before_all_are_armed():
    flight = Flight().run(until=Step.READY, not_ready="bridge2 (waiting for the mode)")
    flight.run(60.0)
    assert flight.step is Step.READY
    assert CommandRequest.ARM not in flight.requested()
    flight.run(until=Step.ARMED, not_ready="", not_armed="bridge2 (arming)")
    flight.run(5.0)
    assert Stream.CLIMB not in flight.streams()
    flight.run(until=Step.TAKEOFF, not_armed="")


def test_when_another_is_not_armed_in_time_this_one_disarms_on_the_ground():
    flight = Flight().run(until=Step.ARMED, not_armed="bridge2 (arming)").run(until=Step.FAILED)
    assert "armed, waiting for the others: not within 8 s: waiting for bridge2 (arming)" in (
        flight.procedure.fault
    )
    assert Stream.CLIMB not in flight.streams()
    assert not flight.snapshot.armed


@pytest.mark.parametrize("step", [Step.READY, Step.ARMED])
def test_when_another_gives_up_this_one_stays_on_the_ground(step):
    held = {Step.READY: {"not_ready": "bridge2"}, Step.ARMED: {"not_armed": "bridge2"}}[step]
    flight = Flight().run(until=step, **held)
    flight.run(until=Step.FAILED, companion_out="bridge2 failed: arming refused")
    assert "bridge2 failed: arming refused" in flight.procedure.fault
    assert Stream.CLIMB not in flight.streams()
    assert not flight.snapshot.armed


def test_a_vehicle_in_the_wrong_place_is_not_armed():
    flight = Flight().run(until=Step.FAILED, misplaced="stands 0.02 m from bridge2")
    assert flight.procedure.fault == "not armed: stands 0.02 m from bridge2"
    assert CommandRequest.ARM not in flight.requested()


def test_vehicles_that_stand_close_climb_in_turns():
    flight = Flight().run(until=Step.ARMED, climbs_first="bridge1").run(4.0)
    assert flight.step is Step.ARMED
    flight.run(until=Step.TAKEOFF, climbs_first="")


def test_stop_while_armed_on_the_ground_disarms():
    flight = Flight().run(until=Step.ARMED, not_armed="bridge2")
    flight.run(until=Step.DONE, stop_request="land")
    assert flight.procedure.fault == ""
    assert Stream.CLIMB not in flight.streams()


@pytest.mark.parametrize(
    ("change", "forced"),
    [({}, True), ({"height_m": 1.0}, False), ({"mode": FlightMode.OTHER}, False)],
)
def test_one_that_does_not_disarm_on_the_ground_lands_and_is_forced_if_it_never_left_it(
    change, forced
):
    """PX4 takes setpoints on the ground for a take-off, and denies the plain disarm."""
    flight = Flight().run(until=Step.ARMED, not_armed="bridge2")
    flight.ignored = {CommandRequest.DISARM, CommandRequest.LAND}
    began = flight.snapshot.now_s
    flight.run(until=Step.DISARM, companion_out="bridge2 failed: arming refused")
    flight.run(2.9, **change)
    requested = flight.requested(began)
    assert requested[0] is CommandRequest.DISARM
    assert (CommandRequest.LAND in requested) == ("mode" not in change)
    assert (CommandRequest.KILL in requested) == forced
    assert flight.snapshot.armed != forced


def test_a_pilot_who_takes_over_before_take_off_has_the_vehicle():
    flight = Flight().run(until=Step.ARMED, not_armed="bridge2")
    flight.obeys = False
    flight.run(until=Step.YIELDED, mode=FlightMode.OTHER)
