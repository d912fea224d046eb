"""The figures of flights whose every number is known in advance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ptnsbc_io.wire import Diagnostics, DiagnosticStatus
from ptnsbc_nodes.uav.step_log import TickNote, UsedMessage
from ptnsbc_nodes.uav.uav_controller import StepTime
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.verdict import Recording, Track
from ptnsbc_tools.live.watch import stage
from ptnsbc_tools.plotting import draw
from ptnsbc_tools.plotting.charts import (
    CHARTS,
    COLOURS,
    DARK_COLOURS,
    FLOOR_M,
    MOST_DISTANCES,
    charts,
    look,
    thinned,
    view_of,
)
from ptnsbc_tools.reading.bag_reader import StatusCollector, StatusSeries
from ptnsbc_tools.report.page import uav_of


def drawn(recording, status=None):
    return {chart.key: chart for chart in charts(view_of(recording, status or StatusSeries()))}


def test_errors_with_deadline_tolerance_and_band(fly):
    chart = drawn(fly({3: lambda t: 4.0 * np.exp(-t)}))["errors"]
    third = chart.curves[2]
    assert (third.label, third.uavs) == ("UAV 3", (3,))
    np.testing.assert_allclose(third.values, 4.0 * np.exp(-third.t))  # also below the axis
    assert chart.curves[0].label == "UAV 1 (leader)"
    assert [mark.t for mark in chart.marks] == [5.0]
    assert [limit.value for limit in chart.limits] == [0.05]
    assert chart.band == (FLOOR_M, pytest.approx(0.08))  # 2 % of four metres


def test_every_leg_with_its_deadline_and_a_gap_between(fly):
    legs = ((0, "form"), (9 * 10**9, "hold"), (12 * 10**9, "form"))
    chart = drawn(fly({3: lambda t: 1.0 + 0 * t}, seconds=20.0, epochs=legs))["errors"]
    assert [(mark.t, mark.label) for mark in chart.marks] == [
        (5.0, "deadline 5 s"),
        (9.0, "hold: formation over"),  # why there is nothing until 12 s
        (12.0, "form, leg 2"),
        (17.0, "deadline 5 s, leg 2"),
    ]
    third = chart.curves[2]
    (gap,) = np.flatnonzero(np.isnan(third.values))
    assert (third.t[gap - 1], third.t[gap + 1]) == (9.0, 12.0)
    assert third.t[-1] == pytest.approx(19.99)
    np.testing.assert_allclose(np.delete(third.values, gap), 1.0)


def test_time_in_which_an_error_is_excused(fly, count):
    active = count(12.0, active=lambda t: np.clip(t - 7.0, 0.0, 1.0))
    recording = fly()
    recording = replace(recording, counters={**recording.counters, 4: active})
    ((begin, end),) = drawn(recording)["errors"].spans
    assert begin == pytest.approx(7.0)
    assert 8.0 < end <= 12.0


def test_inputs_against_weight_and_limit(fly):
    recording = fly()
    series = recording.wrench[2]
    values = series.values.copy()
    values[50] = [3.0, 4.0, 0.0, 0.0, 0.6, 0.8]
    found = drawn(replace(recording, wrench={**recording.wrench, 2: Track(series.t_ns, values)}))
    scenario = recording.scenario
    weight = scenario.plant.mass_kg * scenario.world.gravity_m_s2
    assert found["force"].curves[1].values[50] == pytest.approx(5.0)
    assert found["torque"].curves[1].values[50] == pytest.approx(1.0)
    assert [limit.value for limit in found["force"].limits] == [pytest.approx(weight), 25.9]


def test_separations_are_distances_with_their_keep_outs(fly):
    recording = fly(scenario=load_scenario("paper_5", {"timing.duration_s": 12.0}))
    found = drawn(recording)
    scenario = recording.scenario
    nearest = found["between"].curves
    for curve, uav in zip(nearest, scenario.uav_ids, strict=True):
        offset = scenario.offset(uav)
        others = [scenario.offset(one) - offset for one in scenario.uav_ids if one != uav]
        assert curve.uavs == (uav,)
        np.testing.assert_allclose(curve.values, min(np.linalg.norm(one) for one in others))
    assert [limit.value for limit in found["between"].limits] == [0.5]
    away = {curve.label: curve for curve in found["obstacles"].curves}
    assert away.keys() == {body.name for body in scenario.world.bodies}
    centre = scenario.world.bodies[0].position
    starts = [series.values[0, :3] - centre for series in recording.odometry.values()]
    assert away["O1"].values[0] == pytest.approx(min(np.linalg.norm(one) for one in starts))
    assert [limit.value for limit in found["obstacles"].limits] == [1.5]


def test_heights_count_less_where_keep_outs_are_higher_than_wide(fly):
    changes = {"timing.duration_s": 12.0, "formation.offsets_m.4": [0, 0, 0.9]}
    above = {**changes, "formation.uav_keep_out_above_m": 1.5}
    for keys, apart_m in ((changes, 0.9), (above, 0.3)):
        chart = drawn(fly(scenario=load_scenario("paper_5_free", keys)))["between"]
        assert float(np.min(chart.curves[3].values)) == pytest.approx(apart_m)


def test_only_the_least_distances_of_many(fly, monkeypatch):
    monkeypatch.setattr("ptnsbc_tools.plotting.charts.MOST_DISTANCES", 3)
    chart = drawn(fly({5: lambda t: -1.0 - 0 * t}))["between"]
    # Five, moved a metre west, is 0.2 m east and 2.4 m south of the leader, and closer to 4 and 3.
    closest = [float(curve.values.min()) for curve in chart.curves]
    assert len(chart.curves) == 3 < MOST_DISTANCES
    assert max(closest) < 1.5
    assert chart.note.endswith(" The 3 least of 5.")


def test_the_estimate_of_the_leader(fly):
    recording = fly()
    series = recording.odometry[1]
    moved = series.values.copy()
    moved[:, 2] += 0.25
    recording = replace(recording, estimate={4: Track(series.t_ns, moved)})
    (curve,) = drawn(recording)["estimator"].curves
    assert curve.label == "UAV 4"
    np.testing.assert_allclose(curve.values, 0.25)


def told(stamp, name, **values):
    return Diagnostics(
        stamp, (DiagnosticStatus(name, 0, "", {k: str(v) for k, v in values.items()}),)
    )


def status(arrays):
    collector = StatusCollector()
    for array in arrays:
        collector.add_diagnostics(array)
    return collector.series()


def test_what_the_nodes_told_over_time(fly):
    seconds = range(0, 10)
    arrays = [told(s * 10**9, "uav2: planner", gain=s / 2, missed_ticks=7 + s) for s in seconds]
    arrays += [told(s * 10**9, "sim: world", latency_p99_ms=3 + s) for s in seconds]
    arrays += [told(0, "uav2: planner", gain="nonsense"), told(0, "battery", gain=1)]
    found = drawn(fly(), status(arrays))
    np.testing.assert_allclose(found["gain"].curves[0].values, np.arange(10) / 2)
    np.testing.assert_allclose(found["missed"].curves[0].values, np.arange(10))  # since the epoch
    assert [curve.label for curve in found["latency"].curves] == ["p99"]
    assert [limit.value for limit in found["latency"].limits] == [10.0]


def test_the_age_of_what_a_step_was_made_of(fly):
    def note(now_ms, **stamps_ms):
        moment = StepTime(now_ms * 10**6, 10**7, 0, 0, 0, True)
        used = {name: UsedMessage(ms * 10**6, 0) for name, ms in stamps_ms.items()}
        return TickNote(0, moment, used)

    notes = [
        note(20, own=20, near=1, state1=18, estimate3=13),
        note(30, own=30),  # nobody's message: no age
        note(40, own=31, state1=40),
    ]
    collector = StatusCollector()
    for one in notes:
        collector.add_tick(2, one)
    (block,) = collector.series()["age_ms"][2].blocks()
    assert block.t_ns.tolist() == [20 * 10**6, 40 * 10**6]
    np.testing.assert_allclose(block.values[:, 0], [7.0, 0.0])
    chart = drawn(fly(), collector.series())["age"]
    np.testing.assert_allclose(chart.curves[0].values, [7.0, 0.0], atol=1e-12)
    assert chart.floor == 0.1  # the axis is logarithmic
    assert [limit.value for limit in chart.limits] == [500.0]


def test_lockstep_has_neither_latency_nor_missed_ticks(fly):
    arrays = [told(s * 10**9, "sim: world", latency_p99_ms="0.000") for s in range(9)]
    arrays += [told(s * 10**9, "uav2: planner", missed_ticks=0) for s in range(9)]
    assert not {"latency", "missed"} & drawn(fly(), status(arrays)).keys()


def test_a_flight_that_cannot_be_judged_shows_what_there_is(fly):
    recording = fly()
    odometry = {uav: series for uav, series in recording.odometry.items() if uav != 3}
    flight = view_of(replace(recording, odometry=odometry), StatusSeries())
    assert flight.verdict is None
    assert "/uav3/odom" in flight.problem
    keys = [chart.key for chart in charts(flight)]
    assert "errors" not in keys
    assert {"force", "between"} <= set(keys)
    nothing = view_of(replace(recording, odometry={}), StatusSeries())
    assert list(charts(nothing)) == []


def test_names_are_keys(fly) -> None:
    view = view_of(fly(seconds=7.0), StatusSeries())
    made = {name: make(view) for name, make in CHARTS.items()}
    assert made["force"] is not None
    assert all(chart is None or chart.key == name for name, chart in made.items())


def in_charts(recording: Recording) -> list[dict[int, str]]:
    """Of every chart that has one curve for each UAV."""
    found = charts(view_of(recording, StatusSeries()))
    each = [[one for one in chart.curves if len(one.uavs) == 1] for chart in found]
    return [{one.uavs[0]: COLOURS[one.look.colour] for one in curves} for curves in each if curves]


def in_paths(recording: Recording) -> dict[int, str]:
    axes = draw.blank_figure((4, 4)).add_subplot()
    draw.draw_paths(axes, recording)
    named = [line for line in axes.lines if str(line.get_label()).startswith("UAV ")]
    return {int(str(line.get_label()).split()[1]): str(line.get_color()) for line in named}


def test_a_uav_has_the_same_colour_everywhere(fly: Callable[..., Recording]) -> None:
    recording = fly(seconds=7.0)
    scenario = recording.scenario
    wanted = {uav: COLOURS[look(row).colour] for row, uav in enumerate(scenario.uav_ids)}
    assert len(set(wanted.values())) == len(wanted) == 5
    drawn = in_charts(recording)
    assert len(drawn) > 3 and all(one.items() <= wanted.items() for one in drawn)
    assert drawn[0] == wanted
    assert in_paths(recording) == wanted
    page = stage(scenario)
    assert page["colours"] == {"light": COLOURS, "dark": DARK_COLOURS}
    assert {one["id"]: COLOURS[one["colour"]] for one in page["space"]["uavs"]} == wanted
    assert {uav: COLOURS[uav_of(scenario, uav)["colour"]] for uav in wanted} == wanted


def test_the_dark_palette_has_a_colour_for_each_light_one() -> None:
    assert len(set(DARK_COLOURS)) == len(set(COLOURS)) == len(COLOURS)


CURVES = arrays(
    np.float64,
    st.integers(2, 400),
    elements=st.floats(-1e3, 1e3) | st.just(float("nan")),
)


@given(CURVES, st.integers(8, 60))
def test_ends_peaks_and_gaps_stay(values, points):
    t = np.arange(values.size, dtype=np.float64)
    kept = thinned(t.size, [(t, {0: values})], points)[0]
    assert kept.t.size == kept.values.size <= max(points, 8)
    assert (kept.t[0], kept.t[-1]) == (0, values.size - 1)
    assert (np.diff(kept.t) > 0).all()
    np.testing.assert_array_equal(values[kept.t.astype(int)], kept.values)
    if np.isfinite(values).any():
        assert np.nanmax(kept.values) == np.nanmax(values)
        assert np.nanmin(kept.values) == np.nanmin(values)
    assert np.isnan(kept.values).any() == np.isnan(values).any()


def test_a_needle_keeps_its_height_and_its_time():
    t = np.linspace(0, 60, 6001)
    values = np.zeros(6001)
    values[1234] = 7.0
    kept = thinned(t.size, [(t, {0: values})], 200)[0]
    assert kept.values.max() == 7.0
    assert kept.t[kept.values.argmax()] == t[1234]


def test_what_is_short_is_left_alone():
    t, values = np.arange(5.0), np.arange(5.0)
    np.testing.assert_array_equal(thinned(t.size, [(t, {0: values})], 8)[0].values, values)


@given(CURVES, st.integers(8, 60), st.data())
def test_in_pieces_nothing_is_lost_either(values, points, data):
    t = np.arange(values.size, dtype=np.float64)
    cuts = sorted(data.draw(st.lists(st.integers(0, values.size), max_size=6)))
    spans = zip([0, *cuts], [*cuts, values.size], strict=True)
    blocks = ((t[begin:end], {0: values[begin:end]}) for begin, end in spans)
    kept = thinned(values.size, blocks, points)[0]
    assert (kept.t[0], kept.t[-1]) == (0, values.size - 1) and (np.diff(kept.t) > 0).all()
    np.testing.assert_array_equal(values[kept.t.astype(int)], kept.values)
    assert {np.nanmax(kept.values), np.nanmin(kept.values)} == {
        np.nanmax(values),
        np.nanmin(values),
    } or np.isnan(values).all()
    assert np.isnan(kept.values).any() == np.isnan(values).any()
