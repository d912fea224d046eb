"""What the pre-flight check refuses, and what it lets pass."""

import math
from typing import Any

import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.swarm import fly
from ptnsbc_sim.verdict import verdict_on
from ptnsbc_sim.verdict.recording import recording_of
from ptnsbc_tools.check import CheckError, CheckReport, Finding, check, geometry
from ptnsbc_tools.check.gains import leader_error_std_m


def errors(**changes: Any) -> list[Finding]:
    overrides = {key.replace("__", "."): value for key, value in changes.items()}
    scenario = load_scenario("paper_5", overrides)
    return [finding for finding in check(scenario) if finding.severity == "error"]


@pytest.mark.parametrize(
    ("name", "plant", "task"),
    [
        ("paper_5", "quadrotor", "distance_angles"),
        ("paper_5", "rigid_body_6dof", "relative_position"),
        ("paper_5_free", "rigid_body_6dof", "parent_angle"),
    ],
)
def test_shipped_scenarios_pass(name: str, plant: str, task: str) -> None:
    scenario = load_scenario(name, {"plant.kind": plant, "formation.task": task})
    findings = check(scenario)
    CheckReport(scenario, tuple(findings)).refuse()
    assert all(finding.severity == "info" for finding in findings)


# The leader at the tip, two arms at right angles: UAV 4 sees the leader and UAV 3 at 90 degrees.
V = {2: [-1.5, -1.5, 0], 3: [-0.75, -0.75, 0], 4: [0.75, -0.75, 0], 5: [1.5, -1.5, 0]}


def test_a_right_angled_v_is_singular_for_a_task_that_closes_every_error() -> None:
    found = errors(formation__offsets_m=V, formation__approach="task")
    assert [finding.key for finding in found] == ["formation.offsets_m.4"]
    assert "sigma_min" in found[0].value
    assert "parent_angle" in found[0].advice


def test_a_planned_approach_holds_a_right_angled_v_by_positions_and_check_says_so() -> None:
    """The singular task never takes over, so the formation is met as if the task were relative_position."""
    keys = {"formation.offsets_m": V, "timing.duration_s": 8.0}
    scenario = load_scenario("paper_5_free", keys)
    found = [finding for finding in check(scenario) if finding.severity != "info"]
    assert [(finding.severity, finding.key) for finding in found] == [
        ("warning", "formation.offsets_m.4")
    ]
    assert found[0].limit == ">= 0.35, or relative positions hold UAV 4"
    assert "parent_angle" in found[0].advice
    assert verdict_on(recording_of(fly(scenario))).verdict == "met"


def test_the_same_v_is_fine_by_the_angle_at_the_parent() -> None:
    assert errors(formation__offsets_m=V, formation__task="parent_angle") == []


def test_deadline_below_what_the_speed_limit_allows() -> None:
    """UAVs 3 and 4 start 7.97 m away, and settle for 1/kappa: 2.1875 * 7.975 / (3 - 0.5) + 1 / 2.2 = 7.433 s."""
    (found,) = errors(gains__filter={"max_speed_m_s": 3})
    assert found.key == "gains.formation.deadline_s"
    assert found.limit.startswith(">= 7.44 s, with 2.5 m/s")
    assert (
        found.value
        == "5 s, too short for 5 of 5 UAVs; UAV 3 has 7.97 m to fly to its place and needs 7.44 s"
    )


def test_deadline_below_what_the_acceleration_limit_allows() -> None:
    """The leader's circle takes 0.05 m/s^2 of it: sqrt(7.513 * 7.975 / 0.95) + 1 / 2.2 = 8.396 s."""
    (found,) = errors(gains__filter={"max_acceleration_m_s2": 1})
    assert found.limit.startswith(">= 8.40 s")


@pytest.mark.parametrize("x", [3.0, 5.0, 9.0])
def test_the_deadline_that_is_named_is_enough_and_no_shorter_one_is(x: float) -> None:
    """Starts of unlike errors; the deadline is named to a hundredth of a second."""
    starts = {"uavs[0].position_m": [x, -x, 5], "uavs[2].position_m": [-x, 0, 5]}
    (found,) = errors(gains__formation__deadline_s=2, **starts)
    named = float(found.advice.split("at least ")[1].split(" s")[0])
    assert not errors(gains__formation__deadline_s=named, **starts)
    assert errors(gains__formation__deadline_s=round(named - 0.01, 2), **starts)


def test_desired_positions_closer_than_the_safe_distance() -> None:
    found = errors(**{"formation__offsets_m__3": [-0.6, -1.2, 0], "formation__uav_keep_out_m": 1.3})
    desired = [finding for finding in found if finding.key == "formation.offsets_m"]
    assert "UAV 3 and UAV 4 1.20 m apart" in [finding.value for finding in desired]
    assert desired[0].limit == ">= 1.32 m"  # 0.02 m of clearance.margin_m


def test_a_tolerance_as_wide_as_the_keep_out_is_a_warning() -> None:
    """Centimetres meant: with 5 m every flight is met before it begins."""
    findings = check(load_scenario("paper_5", {"formation.tolerance_m": 5}))
    (found,) = (finding for finding in findings if finding.severity == "warning")
    assert (found.key, found.value) == ("formation.tolerance_m", "5 m")
    assert found.limit == "< 0.5 m, formation.uav_keep_out_m"


@pytest.mark.parametrize(("above_m", "found"), [(None, 0), (1.5, 1)])
def test_a_start_above_another_one_is_in_its_downwash(above_m: float | None, found: int) -> None:
    above = {"uavs[1].position_m": [5, 5, 1], "uavs[2].position_m": [5, 5, 2]}
    near = errors(formation__uav_keep_out_above_m=above_m, **above)
    values = [one.value for one in near if one.key == "uavs position_m"]
    assert values == found * ["UAV 2 and UAV 3 0.33 m apart, as if side by side"]


def test_starts_closer_than_the_safe_distance() -> None:
    found = errors(**{"uavs[1].position_m": [-1, -0.3, 1]})
    assert [finding.key for finding in found] == ["uavs position_m"]
    assert found[0].value == "UAV 2 and UAV 3 0.30 m apart"


def test_start_inside_an_obstacle() -> None:
    found = errors(**{"uavs[4].position_m": [5.5, -4.5, 8]})
    assert found[0].key == "uavs[4].position_m"
    assert found[0].value == "UAV 5 starts 1.00 m from O1"


def test_a_gain_too_large_for_the_control_period() -> None:
    found = errors(gains__formation__kappa_1_s=300)
    assert [finding.key for finding in found] == ["gains.formation"]


@pytest.mark.parametrize(
    ("profile", "plant", "loud"),
    [
        ("paper", "quadrotor", 1),
        ("paper", "rigid_body_6dof", 0),
        ("soft", "quadrotor", 0),
        ("reference", "quadrotor", 0),
    ],
)
def test_the_printed_gains_on_a_quadrotor_are_a_warning(
    profile: str, plant: str, loud: int
) -> None:
    scenario = load_scenario("paper_5", {"gains.profile": profile, "plant.kind": plant})
    warnings = [finding for finding in check(scenario) if finding.severity == "warning"]
    assert [finding.key for finding in warnings] == ["gains.profile"] * loud


def test_a_sensor_that_sees_too_late() -> None:
    assert [finding.key for finding in errors(sensor__range_m=1.4)] == ["sensor.range_m"]


def test_angles_above_the_parent_are_a_finding() -> None:
    found = errors(**{"formation__offsets_m__3": [-1.2, -2.4, 1]})
    assert found[0].key == "formation.offsets_m.3"


def test_encounters_are_named() -> None:
    findings = check(load_scenario("paper_5"))
    values = [finding.value for finding in findings if finding.key == "world.obstacles O1"]
    assert any(value.startswith("meets UAV 5 from t = 18.0 s") for value in values)


def test_the_path_of_a_flight_of_days_is_looked_at_in_wider_steps() -> None:
    """A bounded number of samples: a million seconds take no longer than six hours."""
    hour, days = (load_scenario("paper_5", {"timing.duration_s": s}) for s in (3600.0, 1e6))
    [said] = [one for one in geometry.encounters(days) if one.key == "timing.duration_s"]
    assert (said.severity, said.limit.split(",")[0]) == ("warning", "<= 20005 s")
    assert "every 2.5 s" in said.value
    assert all(one.key != "timing.duration_s" for one in geometry.encounters(hour))


def test_encounters_without_avoidance_are_a_warning() -> None:
    findings = check(load_scenario("paper_5", {"formation.avoidance": "off"}))
    assert {finding.severity for finding in findings if "O1" in finding.key} == {"warning"}


def test_refusal_is_one_line_with_key_and_way_out() -> None:
    scenario = load_scenario("paper_5", {"gains.filter.max_speed_m_s": 3})
    with pytest.raises(CheckError) as caught:
        CheckReport(scenario, tuple(check(scenario))).refuse()
    message = str(caught.value)
    assert "\n" not in message
    assert "paper_5.yaml: gains.formation.deadline_s: 5 s" in message
    assert "set gains.formation.deadline_s to at least" in message


def findings_of(key: str, changes: dict[str, Any] | None = None) -> list[Finding]:
    scenario = load_scenario("paper_5_free", {"formation.assignment": "optimal", **(changes or {})})
    return [finding for finding in check(scenario) if finding.key == key]


def test_open_slots_that_are_far_enough_apart() -> None:
    """Table 2: 1.0 m between UAV 2 and UAV 3 at the start, 1.2 m and more between places; keep-out 0.5 m."""
    apart, paths = findings_of("formation.assignment")
    assert (apart.severity, apart.value) == ("info", "starts 1.00 m apart or more, slots 1.20 m")
    assert apart.limit.startswith(">= 0.71 m")
    assert paths.severity == "info"


def test_open_slots_closer_than_what_the_distance_rests_on() -> None:
    apart, paths = findings_of("formation.assignment", {"formation.uav_keep_out_m": 0.8})
    assert (apart.severity, paths.severity) == ("warning", "info")
    assert apart.limit.startswith(">= 1.13 m")
    assert paths.value.endswith("on their ways")


def test_the_deadline_is_checked_for_the_slots_that_the_starts_take() -> None:
    """Starts far apart, each on the other side of the formation than the own slot."""
    base = load_scenario("paper_5_free")
    starts = [
        {"id": uav, "position_m": (-8.0 * base.offset(uav) + [0.0, 0.0, 6.0]).tolist()}
        for uav in base.uav_ids
    ]
    key = "gains.formation.deadline_s"
    found = findings_of(key, {"uavs": starts})
    fixed = findings_of(key, {"uavs": starts, "formation.assignment": "fixed"})
    needed = [max(float(one.limit.split()[1]) for one in group) for group in (found, fixed)]
    assert needed[0] < needed[1] - 0.2


def test_tasks_do_not_fly_straight_to_open_slots() -> None:
    (found,) = findings_of("formation.approach", {"formation.approach": "task"})
    assert found.severity == "warning"


@pytest.mark.parametrize(
    ("speed", "range_m", "warned"),
    [(3.9, 4.0, False), (5.0, 4.0, True), (5.0, 6.0, False), (6.0, 6.5, False)],
)
def test_who_is_faster_than_it_can_stop_within_sight_is_told_the_speed(
    speed: float, range_m: float, warned: bool
) -> None:
    """Towards a keep-out of 1.5 m. At 5 m/s and a range of 4 m the flight enters it by 13 mm, at 3.9 m/s not."""
    path = {"kind": "line", "position_m": [0, 0, 6], "velocity_m_s": [speed, 0, 0]}
    obstacle = {"name": "O1", "position_m": [8 * speed, 0, 6], "keep_out_m": 1.5}
    changes = {"leader.trajectory": path, "world.obstacles": [obstacle], "sensor.range_m": range_m}
    found = check(load_scenario("paper_5_free", {**changes, "timing.duration_s": 16}))
    slow = [one for one in found if one.key == "sensor.range_m"]
    assert bool(slow) == warned
    if warned:
        assert {one.severity for one in slow} == {"warning"}
        assert slow[0].limit == "<= 4.00 m/s, from which it can stop there"
        assert slow[0].advice.endswith("raise sensor.range_m to 4.99 m")


@pytest.mark.parametrize(
    ("speed", "keep_out_m", "aside_m", "refused"),
    [
        (5.0, 1.5, 0.0, False),
        (10.0, 1.5, 0.0, True),
        (10.0, 1.5, 1.2, False),
        (10.0, 0.5, 0.0, False),
    ],
)
def test_what_no_law_can_evade_is_refused(
    speed: float, keep_out_m: float, aside_m: float, refused: bool
) -> None:
    """The time from 4 m to abreast, against sensor, control and sqrt(2 (keep-out - aside) / 10 m/s^2)."""
    path = {"kind": "line", "position_m": [0, 0, 6], "velocity_m_s": [speed, 0, 0]}
    obstacle = {"name": "O1", "position_m": [8 * speed, aside_m, 6], "keep_out_m": keep_out_m}
    changes = {"leader.trajectory": path, "world.obstacles": [obstacle], "timing.duration_s": 16}
    found = check(load_scenario("paper_5_free", changes))
    said = [one for one in found if "before it is closest" in one.value]
    needed_s = 0.05 + 0.01 + math.sqrt(0.2 * (keep_out_m - aside_m))
    assert refused == (math.sqrt(16.0 - aside_m**2) / speed < needed_s)
    assert bool([one for one in said if one.value.startswith("UAV 1 ")]) == refused
    assert {one.severity for one in said} <= {"error"}


@pytest.mark.parametrize(("length_m", "refused"), [(0.9, False), (1.4, True)])
def test_a_place_in_a_keep_out_for_most_of_the_time_is_refused(
    length_m: float, refused: bool
) -> None:
    """At 0.2 m/s for 10 s after the deadline; half of that is 1 m of the way."""
    path = {"kind": "line", "position_m": [0, 0, 6], "velocity_m_s": [0.2, 0, 0]}
    stands = {"name": "O1", "position_m": [1.8, 0, 6], "keep_out_m": length_m / 2 + 0.05}
    changes = {
        "leader.trajectory": path,
        "world.obstacles": [stands],
        "uavs[0].position_m": [0, 0, 6],
        "timing.duration_s": 15,
    }
    found = check(load_scenario("paper_5_free", changes))
    said = [one for one in found if one.value.startswith("the place of UAV 1 is inside")]
    assert [one.severity for one in said] == ["error"] * refused


@pytest.mark.parametrize(("speed", "told"), [(1.3, False), (1.5, True), (5.0, True)])
def test_ways_back_too_fast_to_stop_before_what_stands_are_told(speed: float, told: bool) -> None:
    path = {"kind": "line", "position_m": [0, 0, 6], "velocity_m_s": [speed, 0, 0]}
    found = check(load_scenario("paper_5_free", {"leader.trajectory": path}))
    beside = [one.value for one in found if one.value.startswith("beside a leader")]
    says = f"beside a leader at {speed:.2f} m/s UAV 1 comes back at up to 2.51 m/s"
    assert beside == ([says] if told else [])


@pytest.mark.parametrize("noise_m", [0.005, 0.02, 0.1])
def test_the_error_that_position_fixes_leave_the_leader_is_foreseen(noise_m: float) -> None:
    """Within a sixth of what four flights of 50 s show, whatever the receiver is."""
    squares = []
    for seed in range(4):
        keys = {"sensor.positioning.noise_m": noise_m, "seed": seed}
        scenario = load_scenario("experiment_4", keys)
        squares.append(verdict_on(recording_of(fly(scenario))).uavs[0].rmse_after_m ** 2)
    flown = math.sqrt(sum(squares) / len(squares) / 3.0)
    assert flown == pytest.approx(leader_error_std_m(scenario), rel=1 / 6)


def test_a_tolerance_within_the_noise_of_the_fixes_is_told_with_one_that_is_not() -> None:
    def said(**keys: float) -> Finding:
        scenario = load_scenario("experiment_4", keys)
        return next(one for one in check(scenario) if one.key == "sensor.positioning")

    tight = said(**{"formation.tolerance_m": 0.05})
    assert tight.severity == "warning"
    wide = float(tight.advice.split("tolerance_m to ")[1].split(" m")[0])
    assert said(**{"formation.tolerance_m": wide + 1e-3}).severity == "info"
    assert said(**{"formation.tolerance_m": wide - 1e-3}).severity == "warning"
    assert said().severity == "info"  # the shipped file follows the advice


@pytest.mark.parametrize(("duration_s", "warned"), [(4.0, True), (5.0, True), (5.01, False)])
def test_a_flight_that_ends_before_its_deadline_is_told(duration_s: float, warned: bool) -> None:
    """The deadline of paper_5 is 5 s; a flight of 5 s has its last instant before it."""
    found = check(load_scenario("paper_5", {"timing.duration_s": duration_s}))
    told = [one for one in found if one.key == "timing.duration_s"]
    assert bool(told) == warned
    if warned:
        assert told[0].severity == "warning"
        assert told[0].value == f"{duration_s:g} s: the flight ends before its deadline"
        assert told[0].limit == "> 5 s, gains.formation.deadline_s"
