"""The procedure in flight: setpoints that stop, pilots, faults, landings, a formation that is given up."""

from dataclasses import replace

import pytest

pytest.importorskip("pymavlink")

from procedure_flight import DT, Flight

from ptnsbc_io.mavlink.autopilots import ARDUPILOT, AUTOPILOTS
from ptnsbc_io.mavlink.flight_mode import FlightMode
from ptnsbc_nodes.bridge.procedure.steps import (
    AWAY_S,
    STOP_S,
    CommandRequest,
    Step,
    Stream,
)


def test_setpoints_stop_first_a_hold_then_silence_then_the_failsafe():
    flight = Flight().flying()
    stopped = flight.snapshot.now_s
    age = 0.05
    while age < 2.0:  # setpoints age from now on
        age += DT
        flight.run(DT, controller_age_s=age)
    held = [t for t, _, output in flight.history if t >= stopped and output.stream is Stream.HOLD]
    silent = [t for t, _, o in flight.history if t >= stopped and o.stream is Stream.NONE]
    assert 0.1 < max(held) - min(held) < 0.5
    assert silent[0] - stopped <= 0.6
    assert flight.streams(silent[0]) == {Stream.NONE}
    assert flight.step is Step.FAILSAFE
    assert flight.requested(stopped) == []


def test_after_a_failsafe_hold_px4_comes_back_by_itself():
    flight = Flight().flying()
    flight.run(3.0, controller_age_s=1.0)
    flight.run(1.0, mode=FlightMode.HOLD)
    back = flight.snapshot.now_s
    flight.run(0.9, controller_age_s=0.05)
    assert flight.streams(back) == {Stream.NONE}
    flight.run(0.5)
    assert flight.history[-1][2].stream is Stream.HOLD
    flight.run(0.5, mode=FlightMode.OWN)
    assert flight.step is Step.FLY
    # one late HEARTBEAT of the failsafe is no pilot
    flight.run(0.3, mode=FlightMode.HOLD).run(1.0, mode=FlightMode.OWN)
    assert flight.step is Step.FLY
    assert flight.procedure.fault == "no setpoints: the controller is silent"
    assert flight.procedure.concern == ""  # it counts no longer
    assert flight.requested(back) == []


def test_a_bridge_that_stood_still_says_so_and_comes_back_as_after_a_silent_controller():
    flight = Flight().flying()
    stopped = flight.history[-1][0]
    flight.snapshot = replace(flight.snapshot, now_s=stopped + 1.5)
    flight.run(0.5, mode=FlightMode.HOLD)  # no pilot: the failsafe of the vehicle has acted
    assert flight.step is Step.FAILSAFE
    assert flight.procedure.fault == (
        "no setpoints: this bridge stood still for 1.5 s: give its computer less work"
    )
    flight.run(0.7).run(1.0, mode=FlightMode.OWN)
    assert flight.step is Step.FLY
    assert flight.requested(stopped) == []


def test_after_a_failsafe_that_a_pilot_kept_the_bridge_yields():
    flight = Flight().flying()
    flight.run(3.0, controller_age_s=1.0)
    flight.run(30.0, mode=FlightMode.HOLD, controller_age_s=0.05)
    assert flight.step is Step.YIELDED
    assert flight.history[-1][2].stream is Stream.NONE


def test_a_failsafe_that_only_waits_ends_with_a_landing():
    flight = Flight(ARDUPILOT).flying()
    stopped = flight.snapshot.now_s
    flight.run(until=Step.LAND, controller_age_s=1.0)
    assert flight.snapshot.now_s - stopped == pytest.approx(ARDUPILOT.land_s, abs=3 * DT)
    flight.run(until=Step.DONE)
    assert "landed after 10 s without setpoints" in flight.procedure.fault


def test_a_vehicle_without_a_failsafe_of_its_own_lands_soon():
    flight = Flight(AUTOPILOTS["ros"]).flying()
    stopped = flight.snapshot.now_s
    flight.run(until=Step.LAND, controller_age_s=1.0)
    assert flight.snapshot.now_s - stopped == pytest.approx(1.5, abs=3 * DT)


def test_a_silent_vehicle_is_not_landed_by_a_mode_it_had_once():
    flight = Flight(ARDUPILOT).flying()
    flight.run(30.0, controller_age_s=1.0, heartbeat_age_s=4.0, state_fault="vehicle silent")
    assert flight.step is Step.FAILSAFE
    assert CommandRequest.LAND not in {output.command for _, _, output in flight.history}


def test_a_failsafe_that_lands_is_left_alone():
    flight = Flight().flying()
    flight.obeys = False
    flight.run(1.0, controller_age_s=1.0)
    flight.run(5.0, mode=FlightMode.LAND)
    flight.run(5.0, controller_age_s=0.05)
    assert flight.step is Step.YIELDED
    flight.run(until=Step.FAILED, armed=False)
    assert "no setpoints: the controller is silent" in flight.procedure.fault


@pytest.mark.parametrize(
    "mode", [FlightMode.OTHER, FlightMode.HOLD, FlightMode.RETURN, FlightMode.LAND]
)
def test_the_pilot_takes_over_and_the_bridge_yields(mode):
    flight = Flight().flying()
    flight.obeys = False
    taken = flight.snapshot.now_s
    flight.run(60.0, mode=mode, mode_name="3", leg="form")
    assert flight.step is Step.YIELDED
    assert "the pilot took over: mode 3" in flight.procedure.fault
    assert flight.streams(taken + DT) == {Stream.NONE}
    assert flight.requested(taken) == []
    assert not flight.history[-1][2].in_formation
    # even the operator's landing is the pilot's to fly now
    flight.run(5.0, leg="land", stop_request="land")
    assert flight.requested(taken) == []
    # and switching back does not hand it over again unseen
    flight.run(5.0, mode=FlightMode.OWN)
    assert flight.streams(taken + DT) == {Stream.NONE}


def test_told_to_return_it_follows_its_setpoints_until_its_mode_has_changed_and_is_left_alone():
    flight = Flight().flying()
    told = flight.snapshot.now_s
    flight.run(2.5, told_home=True)
    assert flight.step is Step.FLY
    assert flight.requested(told) == [CommandRequest.RETURN] * 3  # until it is confirmed
    assert flight.streams(told) == {Stream.PLANNER}
    home = flight.snapshot.now_s
    flight.run(5.0, mode=FlightMode.RETURN)
    assert flight.step is Step.RETURN and not flight.procedure.in_pilots_hands
    assert flight.procedure.fault == "told to return"
    assert flight.requested(home) == [] and flight.streams(home + DT) == {Stream.NONE}
    assert not flight.history[-1][2].in_formation
    flight.run(1.0, armed=False, mode=FlightMode.OWN)
    assert flight.step is Step.DONE


@pytest.mark.parametrize(("order", "step"), [("land", Step.LAND), ("kill", Step.KILL)])
def test_on_its_way_home_the_operators_orders_reach_it_and_so_does_a_pilot(order, step):
    def home():
        return Flight().flying().run(1.0, told_home=True, mode=FlightMode.RETURN)

    assert home().run(DT, told_home=False, stop_request=order).step is step
    flight = home().run(1.0, mode=FlightMode.OTHER, mode_name="POSCTL")
    assert flight.step is Step.YIELDED
    assert flight.procedure.fault.endswith("the pilot took over: mode POSCTL")


def test_a_pilots_mode_comes_before_an_order_to_return():
    flight = Flight().flying()
    flight.run(2.0, mode=FlightMode.OTHER, mode_name="POSCTL", told_home=True)
    assert flight.procedure.fault == "the pilot took over: mode POSCTL"
    assert flight.history[-1][2].command is None


@pytest.mark.parametrize("step", [Step.TAKEOFF, Step.AIRBORNE])
def test_a_formation_that_cannot_begin_is_not_waited_for_in_the_air(step):
    out = "bridge3 failed: no setpoints: the controller is silent"
    flight = Flight().run(until=step)
    flight.run(DT, companion_out=out, height_m=1.0)
    assert flight.step is Step.LAND
    assert flight.procedure.fault == f"no formation: {out}"
    begun = Flight().flying().run(1.0, companion_out=out)
    assert begun.step is Step.FLY
    comes_and_goes = Flight(away_s=AWAY_S).run(until=Step.AIRBORNE).run(1.0, companion_out=out)
    assert comes_and_goes.step is Step.AIRBORNE


@pytest.mark.parametrize("step", [Step.TAKEOFF, Step.AIRBORNE])
def test_a_vehicle_that_is_carried_off_before_the_formation_lands(step):
    flight = Flight().run(until=step).run(DT, strayed="carried 7.0 m off", height_m=1.0)
    assert (flight.step, flight.procedure.fault) == (Step.LAND, "carried 7.0 m off")
    handed_over = Flight(allow_arming=False)
    handed_over.run(until=Step.ARM).run(until=Step.AIRBORNE, armed=True, landed=False, height_m=3.0)
    assert handed_over.run(1.0, strayed="carried 7.0 m off").step is Step.AIRBORNE
    assert Flight().flying().run(1.0, strayed="carried 7.0 m off").step is Step.FLY


def test_the_pilot_takes_over_before_arming():
    flight = Flight()
    flight.ignored = {CommandRequest.ARM}
    flight.run(until=Step.ARM).run(until=Step.FAILED, mode=FlightMode.OTHER)
    assert "before arming" in flight.procedure.fault


@pytest.mark.parametrize(
    "change", [{"battery_low": "battery at 15 %"}, {"fence_breach": "outside the geofence"}]
)
def test_low_battery_and_fence_land_this_vehicle_alone(change):
    flight = Flight().flying().run(until=Step.LAND, **change)
    assert not flight.history[-1][2].in_formation  # the others must not follow it down
    flight.run(until=Step.DONE)
    assert flight.procedure.fault == next(iter(change.values()))


def test_gps_lost():
    flight = Flight().flying()
    flight.run(until=Step.FAILSAFE, state_fault="GPS fix lost", controller_age_s=0.6)
    assert flight.procedure.fault == "no setpoints: GPS fix lost"
    assert flight.history[-1][2].stream is Stream.NONE


def test_heartbeat_lost_and_found():
    flight = Flight().flying()
    flight.run(5.0, heartbeat_age_s=4.0, state_fault="vehicle silent", controller_age_s=4.0)
    assert flight.step is Step.FAILSAFE
    flight.run(until=Step.FLY, heartbeat_age_s=0.1, controller_age_s=0.05)


def test_rebooted_in_flight():
    flight = Flight().flying().run(until=Step.FAILED, rebooted=True, armed=False)
    assert flight.procedure.fault == "the vehicle rebooted in flight"
    gone = flight.snapshot.now_s
    flight.run(60.0, rebooted=False)
    assert flight.requested(gone - DT) == []  # it is not armed again


def test_disarmed_in_flight():
    flight = Flight().flying().run(until=Step.FAILED, armed=False)
    assert flight.procedure.fault == "disarmed in flight"


def test_a_duplicate_sysid_in_flight_changes_nothing():
    flight = Flight().flying().run(5.0, duplicate_sysid=True)
    assert flight.step is Step.FLY


def test_setpoints_go_on_until_the_landing_is_confirmed():
    flight = Flight().flying()
    flight.ignored = {CommandRequest.LAND}
    began = flight.snapshot.now_s
    flight.run(3.0, leg="land")
    assert flight.streams(began) == {Stream.HOLD}
    assert flight.requested(began).count(CommandRequest.LAND) == 3
    flight.run(1.0, mode=FlightMode.LAND)
    assert flight.history[-1][2].stream is Stream.NONE
    # a pilot may still take it out of the landing
    flight.obeys = False
    flight.run(until=Step.YIELDED, mode=FlightMode.OTHER)


def test_a_vehicle_that_stays_armed_on_the_ground_is_disarmed():
    flight = Flight().flying()
    flight.obeys = False
    flight.run(0.1, leg="land").run(4.0, mode=FlightMode.LAND, landed=True, height_m=0.0)
    assert CommandRequest.DISARM not in flight.requested()
    flight.run(3.0)
    assert CommandRequest.DISARM in flight.requested()


def test_no_stream_outlives_stale_setpoints_in_any_step():
    flight = Flight().flying().run(10.0, controller_age_s=STOP_S + 0.01)
    assert flight.history[-1][2].stream is Stream.NONE
    flight = Flight().run(until=Step.AIRBORNE).run(10.0, controller_age_s=STOP_S + 0.01)
    assert flight.history[-1][2].stream is Stream.NONE


def test_a_formation_that_is_given_up_holds_apart_and_then_lands_from_below():
    flight = Flight().flying().run(until=Step.APART, hazard="0.11 m from another vehicle")
    assert flight.history[-1][2] == (Stream.APART, None, False)
    assert flight.procedure.fault == "formation given up: 0.11 m from another vehicle"
    flight.run(10.0)
    assert flight.step is Step.APART
    flight.run(10.0, apart=True, below="a vehicle below")
    assert flight.step is Step.APART
    flight.run(until=Step.LAND, below="").run(until=Step.DONE)


def test_holding_apart_ends_also_when_the_layer_is_never_reached():
    flight = Flight().flying().run(until=Step.APART, hazard="it swings")
    flight.run(until=Step.LAND)
    assert "holding apart by height: not within 60 s" in flight.procedure.fault


@pytest.mark.parametrize(
    ("change", "step"),
    [
        ({"stop_request": "land"}, Step.LAND),
        ({"leg": "land"}, Step.LAND),
        ({"state_fault": "GPS fix lost"}, Step.LAND),
        ({"battery_low": "battery at 9 %"}, Step.LAND),
        ({"mode": FlightMode.OTHER}, Step.YIELDED),
        ({"armed": False}, Step.FAILED),
    ],
)
def test_what_ends_holding_apart_early(change, step):
    flight = Flight().flying().run(until=Step.APART, hazard="it swings")
    flight.obeys = False
    flight.run(until=step, **change)


def test_holding_apart_needs_no_controller():
    flight = Flight().flying().run(until=Step.APART, hazard="it swings")
    flight.run(5.0, controller_age_s=99.0)
    assert flight.step is Step.APART


def test_a_formation_given_up_during_the_take_off_lands_at_once():
    flight = Flight()
    flight.obeys = False
    flight.run(5.0, mode=FlightMode.OWN).run(until=Step.TAKEOFF, armed=True).run(1.0, height_m=1.0)
    flight.run(until=Step.LAND, hazard="told by another bridge")


def test_where_uavs_come_and_go_a_vehicle_is_held_until_its_controller_is_back():
    flight = Flight(away_s=AWAY_S).flying()
    left = flight.snapshot.now_s
    flight.run(until=Step.HELD, controller_age_s=STOP_S + DT).run(20.0)
    assert flight.streams(left + DT) == {Stream.HOLD}
    assert flight.history[-1][2].in_formation  # its process needs its odometry to go on
    flight.run(until=Step.FLY, controller_age_s=0.05).run(1.0)
    assert flight.history[-1][2].stream is Stream.PLANNER
    assert (flight.procedure.fault, flight.requested(left)) == ("", [])


def test_a_vehicle_is_not_held_for_a_controller_that_stays_away():
    flight = Flight(away_s=AWAY_S).flying()
    flight.run(until=Step.HELD, controller_age_s=1.0)
    held = flight.snapshot.now_s
    flight.run(until=Step.LAND)
    assert flight.snapshot.now_s - held == pytest.approx(AWAY_S, abs=3 * DT)
    assert flight.procedure.fault == "landed after 30 s without its controller"
    flight.run(until=Step.DONE)


@pytest.mark.parametrize(
    ("change", "step"),
    [
        ({"mode": FlightMode.OTHER}, Step.YIELDED),
        ({"mode": FlightMode.HOLD}, Step.YIELDED),  # a pilot: no failsafe acts while it is held
        ({"state_fault": "GPS fix lost"}, Step.FAILSAFE),
        ({"battery_low": "battery at 10 %"}, Step.LAND),
        ({"hazard": "told by another bridge"}, Step.APART),
        ({"leg": "land"}, Step.LAND),
        ({"armed": False}, Step.FAILED),
    ],
)
def test_a_vehicle_that_is_held_answers_as_in_formation(change, step):
    flight = Flight(away_s=AWAY_S).flying().run(until=Step.HELD, controller_age_s=1.0)
    flight.run(1.0)
    flight.obeys = False
    flight.run(2 * DT, **change)
    assert flight.step is step


def test_a_bridge_that_stood_still_cannot_have_held_its_vehicle():
    flight = Flight(away_s=AWAY_S).flying()
    flight.snapshot = replace(flight.snapshot, now_s=flight.history[-1][0] + 1.5)
    flight.run(0.2, mode=FlightMode.HOLD)
    assert flight.step is Step.FAILSAFE


def test_one_that_leaves_goes_down_by_its_controller_until_nobody_is_below():
    flight = Flight().flying()
    left = flight.snapshot.now_s
    flight.run(3.0, leg="land", leaves=True, below="a vehicle below")
    assert flight.step is Step.FLY
    assert flight.streams(left) == {Stream.PLANNER}
    flight.run(until=Step.LAND, below="")
    assert flight.history[-1][2].in_formation
    flight.run(until=Step.DONE)
    assert flight.procedure.fault == ""


@pytest.mark.parametrize(("armed", "step"), [(True, Step.LAND), (False, Step.DONE)])
def test_an_order_to_a_bridge_that_begins_waits_for_its_vehicle(armed, step):
    """It had ended at once, with a vehicle in the air of which it had not heard yet."""
    flight = Flight().run(2.0, heartbeat_age_s=float("inf"), stop_request="land")
    assert flight.step is Step.HEARTBEAT
    flight.obeys = False
    flight.run(2 * DT, heartbeat_age_s=0.1, armed=armed)
    assert flight.step is step
    nobody = Flight().run(11.0, heartbeat_age_s=float("inf"), stop_request="land")
    assert nobody.step is Step.DONE


def taken_over(**found):
    """A flight that a bridge has left in the air, and another one begins with."""
    flight = Flight()
    flight.procedure.takes_over = True
    air = {"armed": True, "landed": False, "height_m": 3.0, "mode": FlightMode.OWN, "leg": "form"}
    return flight.run(DT, **{**air, **found})


@pytest.mark.parametrize(
    ("found", "step"),
    [
        ({}, Step.FAILSAFE),
        ({"mode": FlightMode.HOLD}, Step.FAILSAFE),
        ({"mode": FlightMode.LAND}, Step.LAND),
        ({"mode": FlightMode.OTHER}, Step.YIELDED),
        ({"stop_request": "land"}, Step.LAND),
        ({"stop_request": "kill"}, Step.KILL),
        ({"leg": "land"}, Step.LAND),
        ({"armed": False}, Step.FAILED),  # it must not take off again
        ({"wrong_vehicle": "another vehicle"}, Step.FAILED),
    ],
)
def test_what_a_bridge_does_with_the_vehicle_that_it_takes_over(found, step):
    assert taken_over(**found).step is step


def test_a_vehicle_that_is_taken_over_joins_once_its_parameters_and_its_thrust_are_known():
    flight = taken_over(parameters_read=False, unprepared="showing what its thrust does").run(3.0)
    assert (flight.step, flight.streams()) == (Step.FAILSAFE, {Stream.NONE})
    flight.run(3.0, parameters_read=True)
    assert (flight.step, flight.history[-1][2].stream) == (Step.AIRBORNE, Stream.HOLD)
    flight.run(2 * DT, unprepared="")
    assert flight.step is Step.FLY
    assert flight.requested() == []  # it asks for no mode


def test_when_all_land_nobody_waits_for_a_vehicle_below():
    flight = Flight().flying()
    flight.run(2 * DT, leg="land", below="a vehicle below")
    assert flight.step is Step.LAND
