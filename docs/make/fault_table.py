"""The answers of the processes of a flight to faults: the rows of the table in docs/faults.md.

The times are those of the code. Each row names the tests that fly or make its fault; a test of the table runs none.
"""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_io.mavlink.autopilots import PX4
from ptnsbc_nodes.bridge.procedure.steps import (
    AWAY_S,
    HEARTBEAT_LOST_S,
    RECOVERED_S,
    STALE_S,
    STOP_S,
)
from ptnsbc_nodes.comm.diagnostics import SafetyState
from ptnsbc_nodes.comm.door import AHEAD_S, OLDEST_S
from ptnsbc_nodes.runtime.pacing import LIMIT_S
from ptnsbc_nodes.runtime.watchdog import ENDED_S, SAID_S, SLOW_ENDED_S
from ptnsbc_nodes.uav.uav_node import ABANDONED_S
from ptnsbc_sim.counters import STATUS_HZ

HEADLESS, SIM, MAVLINK = "headless", "sim", "mavlink"
ALL = (HEADLESS, SIM, MAVLINK)


class FaultAnswer(NamedTuple):
    """One row."""

    fault: str
    where: tuple[str, ...]  # kinds of flights
    detected_by: str
    within: str
    state: str  # of the safety layer of who answers
    action: str
    recovers: str  # when
    tests: tuple[str, ...]


_NOMINAL, _DEGRADED, _HOLD, _LAND, _STOP = (state.text for state in SafetyState)
_STALE = "`communication.stale_s`"
_STATUS = f"{1.0 / STATUS_HZ:g} s"
_AT_ONCE = "at once"
_NEVER = "no"
_FLEET = "tests/nodes/fleet/test_fleet.py::"
_ENDS = "tests/nodes/comm/test_endpoints.py"
_UAV = "tests/nodes/uav/"
_BRIDGE = "tests/nodes/bridge/"

ANSWERS = (
    FaultAnswer(
        "the parent, or the leader over a leader link, is silent",
        ALL,
        "each follower, by the age of the newest message",
        _STALE,
        _HOLD,
        "holds where it is and keeps clear of others; warns `holding`",
        "when it hears again",
        (
            "tests/sim/disturbances/test_faults.py::test_a_child_of_a_silent_uav_holds_after_stale_s_and_goes_on",
            "tests/core/test_step.py::test_a_silent_neighbour_makes_it_hold_where_it_is",
        ),
    ),
    FaultAnswer(
        "a UAV dies in the middle of the tree",
        ALL,
        "its children, as above",
        _STALE,
        _HOLD,
        "its vehicle stays in place, its children hold, the others fly on around both",
        _NEVER,
        ("tests/sim/test_swarm.py::test_a_uav_in_the_middle_of_the_tree_dies_and_all_keep_clear",),
    ),
    FaultAnswer(
        "a UAV, or the leader, is lost, with `formation.vacancy: keep` or `close_up`",
        ALL,
        "all others, by the age of the newest message",
        _STALE,
        _NOMINAL,
        "its children get another parent, or the next of `leader.successors` leads; nobody holds",
        "it takes its slot again, by a deadline of its own, when it is heard again",
        (
            "tests/sim/test_roles.py::test_a_loss_moves_nobody_by_more_than_the_stated_jump",
            "tests/sim/test_roles.py::test_a_restarted_uav_comes_back_and_nobody_holds_meanwhile",
            "tests/nodes/fleet/test_fault_injector.py::test_a_fleet_in_lockstep_comes_and_goes_as_the_headless_flight_does",
            f"{_BRIDGE}test_fleet_comings.py::test_vehicles_join_late_are_held_leave_and_lose_their_leader_to_a_pilot",
            f"{_BRIDGE}test_fleet_comings.py::test_when_the_bridge_of_the_leader_dies_the_others_move_up_past_its_vehicle",
        ),
    ),
    FaultAnswer(
        "a neighbour in the estimator graph is silent",
        ALL,
        "each follower, by the age of the newest message",
        _STALE,
        _DEGRADED,
        "its estimate is left out",
        "when it is heard again",
        ("tests/core/test_step.py::test_a_neighbours_estimate_counts_until_it_is_stale",),
    ),
    FaultAnswer(
        "a message is damaged, not finite, out of range or out of order",
        (SIM, MAVLINK),
        "the door of each subscription",
        _AT_ONCE,
        _DEGRADED,
        "dropped, counted, named; the last good one counts",
        "with the next good one",
        (
            f"{_UAV}test_uav_topics.py::test_a_broken_state_of_a_neighbour_is_dropped_and_named",
            "tests/nodes/sim/test_sim_node.py::test_no_message_ends_the_sim",
            "tests/nodes/fleet/test_fleet_node.py::test_no_message_ends_the_launcher_or_makes_it_end_a_uav",
            "tests/nodes/fleet/test_fault_injector.py::test_a_fleet_in_lockstep_flies_its_faults_as_the_headless_flight_does",
        ),
    ),
    FaultAnswer(
        f"the clock of a sender is off by {LIMIT_S:g} s or more",
        (SIM, MAVLINK),
        "each receiver, by the stamps",
        "1 s",
        _DEGRADED,
        f"named; no flight begins; messages {AHEAD_S:g} s ahead or {OLDEST_S:g} s old are refused",
        "when the clock is set right",
        (
            f"{_UAV}test_uav_status.py::test_no_flight_begins_by_clocks_that_differ",
            "tests/nodes/runtime/test_pacing.py::test_a_clock_that_is_set_right_is_forgiven",
        ),
    ),
    FaultAnswer(
        "a second publisher of a topic that has one",
        (SIM, MAVLINK),
        "each reader, by the graph",
        f"{_STATUS} after its discovery",
        _DEGRADED,
        "no flight begins; in flight named with its node; its messages are refused with `security: signed`",
        "when it is gone",
        (
            f"{_UAV}test_leg_services.py::test_with_a_seal_no_leg_of_an_outsider_counts",
            f"{_UAV}test_uav_status.py::test_no_flight_begins_beside_a_rival_and_one_in_flight_is_named",
            f"{_ENDS}::test_with_a_seal_the_messages_of_an_outsider_do_not_push_out_the_true_one",
        ),
    ),
    FaultAnswer(
        "the own odometry is stale",
        (SIM, MAVLINK),
        "the UAV",
        _STALE,
        _STOP,
        "no setpoints: a setpoint is the proof of life; `/diagnostics` error",
        "with the next odometry",
        (f"{_UAV}test_uav_node.py::test_real_time_setpoints_end_with_the_odometry",),
    ),
    FaultAnswer(
        "a UAV process hangs or ends in real time",
        (SIM,),
        "the sim, by the age of the wrench",
        _STALE,
        _HOLD,
        "its vehicle keeps its attitude from the third control period on, then stays in place, and is named; its "
        "children hold",
        f"when it is back; one without a launcher ends {ABANDONED_S:g} s after the sim",
        (
            "tests/nodes/sim/test_sim_node.py::test_a_vehicle_keeps_its_attitude_while_a_process_stands_still",
            "tests/nodes/sim/test_sim_node.py::test_real_time_runs_by_the_clock_and_hovers_without_wrenches",
            "tests/nodes/sim/test_sim_node.py::test_a_uav_that_comes_back_in_real_time_flies_its_vehicle_again",
        ),
    ),
    FaultAnswer(
        "a UAV process ends in flight",
        (SIM, MAVLINK),
        "the launcher, by the exit code",
        "0.1 s",
        _HOLD,
        "named with its last log lines; no process waits for it; exit code 1, unless the scenario kills it",
        _NEVER,
        (f"{_FLEET}test_who_dies_in_flight_is_named_and_the_others_fly_on",),
    ),
    FaultAnswer(
        "a process of several UAVs ends in flight (`--processes`)",
        (SIM,),
        "the launcher, by the exit code",
        "0.1 s",
        _HOLD,
        "each of its UAVs is lost, as above; a scenario whose faults strike one of them is refused",
        _NEVER,
        (
            f"{_FLEET}test_the_end_of_a_process_is_the_end_of_its_uavs",
            "tests/nodes/fleet/test_process_list.py::test_the_fault_of_one_uav_must_not_strike_those_beside_it",
        ),
    ),
    FaultAnswer(
        "a UAV process hangs in lock-step",
        (SIM,),
        "the sim, by the missing wrench",
        f"{SAID_S:g} s",
        _HOLD,
        f"named; ended by the launcher after {ENDED_S:g} s, after {SLOW_ENDED_S:g} s also with signs of life",
        f"if it goes on within {ENDED_S:g} s",
        (f"{_FLEET}test_who_dies_in_flight_is_named_and_the_others_fly_on",),
    ),
    FaultAnswer(
        "a recorder hangs in lock-step",
        (SIM,),
        "the sim, by what it acknowledges",
        f"{SAID_S:g} s",
        _NOMINAL,
        f"the sim pauses; the launcher ends the recorder after {SLOW_ENDED_S:g} s, since a disk may be slow",
        f"if it goes on within {SLOW_ENDED_S:g} s",
        ("tests/nodes/fleet/test_supervisor.py::test_a_process_that_is_stuck_is_ended",),
    ),
    FaultAnswer(
        "a recorder ends, or its disk is full",
        (SIM, MAVLINK),
        "the launcher, by the exit code",
        "0.1 s",
        _NOMINAL,
        "named; the flight goes on without a verdict; `ptnsbc bag repair` mends `<bag>.part`; exit code 1",
        _NEVER,
        (
            f"{_FLEET}test_without_its_recorder_the_flight_goes_on_and_the_bag_can_be_mended",
            "tests/io/bag/test_writer.py::test_full_disk",
            "tests/nodes/fleet/test_fault_injector.py::test_a_full_disk_is_an_error_of_the_process_that_writes",
        ),
    ),
    FaultAnswer(
        "the sim ends",
        (SIM,),
        "the launcher, by the exit code",
        "0.1 s",
        _STOP,
        "the flight is over, the bag is complete; exit code 1",
        _NEVER,
        (f"{_FLEET}test_who_dies_in_flight_is_named_and_the_others_fly_on",),
    ),
    FaultAnswer(
        "the sim hangs",
        (SIM,),
        "the launcher, by the sim's log and statuses",
        "30 s",
        _STOP,
        "named and ended, then as above",
        "if it goes on within 30 s",
        ("tests/nodes/fleet/test_supervisor.py::test_a_sim_without_a_sign_of_life_is_ended",),
    ),
    FaultAnswer(
        "the launcher is killed",
        (SIM, MAVLINK),
        "each process, by the end of its parent",
        _AT_ONCE,
        _STOP,
        "its processes end by themselves",
        _NEVER,
        (f"{_FLEET}test_no_process_outlives_a_killed_launcher",),
    ),
    FaultAnswer(
        "the controller of a vehicle is silent",
        (MAVLINK,),
        "the thread of its bridge, whatever ROS does",
        f"{STALE_S:g} s",
        f"{_HOLD}, {_STOP}, {_LAND}",
        f"held where it is; after {STOP_S:g} s the stream stops, and the failsafe of the vehicle acts; a vehicle that "
        f"{PX4.land_s:g} s later is still in the mode of its bridge is landed; once the stream stopped, exit code 1",
        f"when setpoints have been fresh for {RECOVERED_S:g} s, and no pilot has taken over",
        (
            f"{_BRIDGE}procedure/test_procedure_in_flight.py::test_setpoints_stop_first_a_hold_then_silence_then_the_failsafe",
            f"{_BRIDGE}procedure/test_procedure_in_flight.py::test_after_a_failsafe_hold_px4_comes_back_by_itself",
            f"{_BRIDGE}procedure/test_procedure_in_flight.py::test_a_failsafe_that_only_waits_ends_with_a_landing",
            f"{_BRIDGE}test_bridge.py::test_setpoints_end_the_stream_ends_the_failsafe_acts_and_then_the_pilot",
        ),
    ),
    FaultAnswer(
        "the controller of a vehicle is silent, where UAVs come and go (`formation.vacancy`)",
        (MAVLINK,),
        "the thread of its bridge, whatever ROS does",
        f"{STALE_S:g} s",
        f"{_HOLD}, {_LAND}",
        f"held where it is, and landed after {AWAY_S:g} s",
        "at once, when its controller is back: it takes its slot again",
        (
            f"{_BRIDGE}procedure/test_procedure_in_flight.py::test_where_uavs_come_and_go_a_vehicle_is_held_until_its_controller_is_back",
            f"{_BRIDGE}procedure/test_procedure_in_flight.py::test_a_vehicle_is_not_held_for_a_controller_that_stays_away",
        ),
    ),
    FaultAnswer(
        "a bridge ends in flight",
        (MAVLINK,),
        "the vehicle, by the silence; the launcher, by the exit code",
        "as the vehicle is set",
        _HOLD,
        "the failsafe of the vehicle acts, and everybody keeps clear of it; the launcher starts another bridge, up to "
        "three times; where that fails, it lands the vehicle past it at the end; exit code 1",
        f"when another bridge has had setpoints for {RECOVERED_S:g} s, and no pilot has taken over",
        (
            f"{_BRIDGE}test_fleet_comings.py::test_the_place_of_a_vehicle_without_a_bridge_is_kept_clear",
            f"{_BRIDGE}test_bridge.py::test_a_bridge_killed_leaves_the_vehicle_to_its_failsafe",
            f"{_BRIDGE}test_bridge.py::test_another_bridge_holds_the_vehicle_of_one_that_died_and_brings_it_back",
            "tests/nodes/fleet/test_supervisor.py::test_a_bridge_that_dies_in_flight_is_replaced_three_times_at_most",
            "tests/nodes/fleet/test_emergency_stop.py::test_a_vehicle_that_a_dead_bridge_left_armed_is_landed_and_waited_for",
            f"{_BRIDGE}test_processes.py::test_a_uav_process_and_a_bridge_killed_and_the_operators_stop",
        ),
    ),
    FaultAnswer(
        f"a bridge hangs in flight for more than {STOP_S:g} s",
        (MAVLINK,),
        "the vehicle, by the silence; the bridge, by its own clock",
        "as the vehicle is set",
        _STOP,
        "the failsafe of the vehicle acts; a bridge that goes on says that it stood still; the launcher kills one that "
        f"stands still for {ENDED_S:g} s, and starts another; exit code 1",
        f"when it goes on and setpoints have been fresh for {RECOVERED_S:g} s",
        (
            f"{_BRIDGE}procedure/test_procedure_in_flight.py::test_a_bridge_that_stood_still_says_so_and_comes_back_as_after_a_silent_controller",
            f"{_BRIDGE}test_bridge.py::test_a_bridge_that_stood_still_has_its_vehicle_back_from_the_failsafe",
            "tests/nodes/fleet/test_supervisor.py::test_a_bridge_that_stands_still_is_ended_after_10_s",
        ),
    ),
    FaultAnswer(
        "a vehicle is silent",
        (MAVLINK,),
        "its bridge, by the HEARTBEAT",
        f"{HEARTBEAT_LOST_S:g} s",
        _STOP,
        "named; no setpoints: the failsafe of the vehicle acts",
        "when it is heard again",
        (f"{_BRIDGE}test_bridge.py::test_heartbeat_lost_and_found_again",),
    ),
    FaultAnswer(
        "a vehicle has lost its position",
        (MAVLINK,),
        "its bridge, by the estimator of the vehicle",
        f"{STOP_S:g} s",
        _STOP,
        "no setpoints: the failsafe of the vehicle acts",
        "as above, when the position is back",
        (f"{_BRIDGE}test_bridge.py::test_gps_lost_in_flight",),
    ),
    FaultAnswer(
        "the position of one vehicle jumps, or two come too near",
        (MAVLINK,),
        "each bridge, by the near objects",
        _AT_ONCE,
        f"{_HOLD}, {_LAND}",
        "the formation is given up: all hold apart by height, then land from below",
        _NEVER,
        (
            f"{_BRIDGE}test_fleet_mavlink.py::test_a_jump_of_one_position_makes_all_hold_apart_by_height_and_land",
            f"{_BRIDGE}test_bridge.py::test_a_vehicle_that_comes_too_near_ends_the_formation",
        ),
    ),
    FaultAnswer(
        "a battery is low, or the fence is reached",
        (MAVLINK,),
        "the bridge",
        _AT_ONCE,
        _LAND,
        "this vehicle lands",
        _NEVER,
        (
            f"{_BRIDGE}test_bridge.py::test_a_low_battery_lands_this_vehicle",
            f"{_BRIDGE}test_bridge.py::test_a_fence_in_the_way_lands_it_no_farther_than_it_must",
        ),
    ),
    FaultAnswer(
        "the clock of a vehicle jumps",
        (MAVLINK,),
        "its bridge, by the stamps",
        _AT_ONCE,
        _NOMINAL,
        "measured anew; the flight goes on",
        _AT_ONCE,
        (f"{_BRIDGE}test_bridge.py::test_the_vehicles_clock_jumps_and_the_flight_goes_on",),
    ),
    FaultAnswer(
        "a pilot switches the mode in flight",
        (MAVLINK,),
        "its bridge, by the HEARTBEAT",
        _AT_ONCE,
        _STOP,
        "yields for good: no setpoint, no command",
        _NEVER,
        (
            f"{_BRIDGE}procedure/test_procedure_in_flight.py::test_the_pilot_takes_over_and_the_bridge_yields",
        ),
    ),
    FaultAnswer(
        "a vehicle refuses to arm, or its bridge gives up before the flight",
        (MAVLINK,),
        "its bridge, by HEARTBEAT, SYS_STATUS and the answer; the others, by its word",
        "30 s; 5 s if its checks pass",
        _STOP,
        "the reason of the vehicle is told; no other arms, or all disarm on the ground and name it; those in the air "
        "land",
        _NEVER,
        (
            f"{_BRIDGE}procedure/test_procedure.py::test_no_vehicle_is_ready_before_its_own_checks_pass",
            f"{_BRIDGE}procedure/test_procedure.py::test_arming_refused",
            f"{_BRIDGE}procedure/test_procedure.py::test_when_another_gives_up_this_one_stays_on_the_ground",
            f"{_BRIDGE}test_fleet_mavlink.py::test_when_one_vehicle_refuses_to_arm_no_other_leaves_the_ground",
            f"{_BRIDGE}test_fleet_mavlink.py::test_when_a_uav_process_stops_while_its_vehicle_arms_all_are_down_within_20_s",
        ),
    ),
    FaultAnswer(
        "vehicles stand nearer than the keep-out and the error of their positions, or far from their starts",
        (MAVLINK,),
        "each bridge, before arming",
        _AT_ONCE,
        _STOP,
        "no vehicle arms, and the distance is told; nearer than `climb_spacing_m` besides they climb in turns",
        _NEVER,
        (
            f"{_BRIDGE}test_fleet_mavlink.py::test_vehicles_at_one_place_are_not_armed",
            f"{_BRIDGE}test_fleet_mavlink.py::test_a_vehicle_far_from_its_start_is_not_armed",
            f"{_BRIDGE}test_fleet_mavlink.py::test_vehicles_arm_together_and_those_that_stand_close_climb_in_turns",
        ),
    ),
    FaultAnswer(
        "a vehicle says that a sensor failed, or anything critical; a UAV process or a bridge is late half the time",
        (MAVLINK,),
        "the bridge, by SYS_STATUS, STATUSTEXT and the setpoints",
        "2 s; at once; 3 s (`mavlink.abort`)",
        f"{_HOLD}, {_LAND}",
        "the formation is given up: all hold apart by height, then land from below",
        _NEVER,
        (
            f"{_BRIDGE}test_bridge.py::test_a_sensor_that_fails_in_flight_ends_the_formation",
            f"{_BRIDGE}test_bridge.py::test_a_critical_text_counts_in_flight_and_an_old_one_does_not",
            f"{_BRIDGE}test_bridge.py::test_a_uav_process_that_is_late_half_of_the_time_ends_the_formation",
        ),
    ),
    FaultAnswer(
        "a vehicle swings or runs away (`mavlink.abort`)",
        (MAVLINK,),
        "each bridge, by its error",
        "as the scenario says",
        f"{_HOLD}, {_LAND}",
        "the formation is given up: all hold apart by height, then land from below",
        _NEVER,
        (f"{_BRIDGE}test_bridge.py::test_a_gale_that_carries_a_vehicle_off_ends_the_formation",),
    ),
    FaultAnswer(
        "a vehicle reboots or is disarmed in flight",
        (MAVLINK,),
        "its bridge, by clock and HEARTBEAT",
        _AT_ONCE,
        _STOP,
        "named, and never armed again",
        _NEVER,
        (
            f"{_BRIDGE}procedure/test_procedure_in_flight.py::test_rebooted_in_flight",
            f"{_BRIDGE}procedure/test_procedure_in_flight.py::test_disarmed_in_flight",
        ),
    ),
    FaultAnswer(
        "a second vehicle has the same system id",
        (MAVLINK,),
        "the bridge, by the address",
        _AT_ONCE,
        _NOMINAL,
        "before arming: given up; in flight: only the first address counts",
        _NEVER,
        (
            f"{_BRIDGE}test_bridge.py::test_a_second_vehicle_with_the_same_id_changes_nothing_in_flight",
            f"{_BRIDGE}test_bridge.py::test_a_second_vehicle_with_the_same_id_is_not_armed",
        ),
    ),
    FaultAnswer(
        "a setpoint is too fast, leads out of the fence, or answers no odometry of the bridge",
        (MAVLINK,),
        "the bridge",
        _AT_ONCE,
        _NOMINAL,
        "clamped, led inwards, or dropped; counted",
        "with the next setpoint",
        (
            f"{_BRIDGE}setpoint/test_setpoint_stream.py::test_speeds_are_clamped_and_counted",
            f"{_BRIDGE}setpoint/test_setpoint_guard.py::test_outside_the_fence_every_setpoint_leads_inwards",
            f"{_BRIDGE}test_state_publisher.py::test_only_answers_to_our_own_odometry_count",
        ),
    ),
    FaultAnswer(
        "the operator's order, and a vehicle that is silent or in a pilot's hands",
        (MAVLINK,),
        "its bridge",
        "10 s, 30 s for a kill",
        f"{_LAND}, {_STOP}",
        "repeated; a silent vehicle is given up, with place and mode; a pilot's is left alone without `--all`",
        _NEVER,
        (
            f"{_BRIDGE}procedure/test_procedure.py::test_a_kill_is_repeated_until_the_motors_stand_still",
            f"{_BRIDGE}procedure/test_procedure.py::test_a_vehicle_in_a_pilots_hands_is_left_alone_unless_all_are_meant",
            f"{_BRIDGE}procedure/test_procedure.py::test_a_silent_vehicle_that_must_come_down_is_given_up_and_named",
        ),
    ),
)
"""The faults that are answered, and how."""
