"""Dry runs: seeded, perturbed, and refused where the flight fails."""

import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.sweep import dry_run as module
from ptnsbc_sim.sweep.dry_run import (
    DryFlight,
    DryRun,
    accepts,
    dry_run,
    dry_run_says,
    least_share,
    remedies,
    with_starts_at,
)
from ptnsbc_sim.sweep.plan import plan_of

SHORT = {"timing.duration_s": 7.0}
IN_TIME = load_scenario("paper_5_free", SHORT)
# The leader is 8 m from its place: not within the limits of speed and acceleration.
TOO_SOON = load_scenario("paper_5_free", {**SHORT, "gains.formation.deadline_s": 1.5})


def flight(verdict: str, room_m: float = 0.5, error_m: float = 0.01) -> DryFlight:
    return DryFlight(verdict, 1, "", error_m, room_m)


def test_the_same_seed_gives_the_same_flights():
    first, again, other = (dry_run(IN_TIME, 3, seed) for seed in (4, 4, 5))
    assert first == again
    assert first != other
    assert first.flights[0] == other.flights[0]  # it has no noise, and starts as the file says
    assert len(set(first.flights)) == 4


def test_a_scenario_that_holds_is_accepted():
    done = dry_run(IN_TIME, 4)
    assert (done.met, done.accepted()) == (5, True)
    assert done.least_room_m is not None
    assert accepts(IN_TIME, 4)


def test_a_deadline_that_is_too_short_is_refused_and_mended():
    done = dry_run(TOO_SOON, 2)
    assert not done.accepted()
    assert not accepts(TOO_SOON, 2)
    assert done.worst.cause
    first = next(remedies(TOO_SOON))
    named = float(first.said.removeprefix("set gains.formation.deadline_s to at least ")[:-2])
    assert named == first.changes["gains.formation.deadline_s"]  # what was flown, not rounded down
    mended = load_scenario("paper_5_free", {**SHORT, **first.changes})
    assert accepts(mended, 4, least=1.0)


def test_where_chance_decides_nearly_all_flights_must_be_met():
    """The flight is one of them then; without chance it is the first one, and the others start elsewhere."""
    gusts = load_scenario("paper_5_free", {**SHORT, "world.gust_m_s": [1, 1, 1]})
    half = tuple(flight("met" if k % 2 == 0 else "missed") for k in range(21))
    assert DryRun(half, least_share(IN_TIME)).accepted()
    assert not DryRun(half, least_share(gusts)).accepted()
    one = (*(flight("met") for _ in range(20)), flight("missed"))
    assert DryRun(one, least_share(gusts)).accepted()


def test_progress_counts_all_flights():
    told = []
    dry_run(IN_TIME, 2, progress=lambda done, of: told.append((done, of)))
    assert told == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize(
    ("met", "of", "accepted"), [(21, 21, True), (11, 21, True), (10, 21, False)]
)
def test_half_of_the_flights_must_be_met(monkeypatch, met, of, accepted):
    flights = [flight("met")] * met + [flight("missed")] * (of - met)
    monkeypatch.setattr(module, "_flights", lambda *_: iter(flights))
    assert DryRun(tuple(flights)).accepted() == accepted
    assert accepts(IN_TIME, of - 1) == accepted


@pytest.mark.parametrize("verdict", ["met", "missed"])
def test_no_flight_is_flown_once_the_answer_is_known(monkeypatch, verdict):
    flown = iter([flight("met"), *[flight(verdict)] * 20])
    monkeypatch.setattr(module, "_flights", lambda *_: flown)
    assert accepts(IN_TIME, 20) == (verdict == "met")
    assert len([*flown]) == (10 if verdict == "met" else 9)


def test_the_unperturbed_flight_must_be_met(monkeypatch):
    flights = [flight("missed"), *[flight("met")] * 20]
    monkeypatch.setattr(module, "_flights", lambda *_: iter(flights))
    assert not DryRun(tuple(flights)).accepted()
    assert not accepts(IN_TIME, 20)


def test_the_worst_flight_entered_a_keep_out():
    flights = (flight("met"), flight("missed", error_m=9.0), flight("violated", room_m=-0.1))
    assert DryRun(flights).worst.verdict == "violated"
    assert DryRun(flights).least_room_m == -0.1


def test_links_that_lose_messages_get_worse():
    lossy = load_scenario("paper_5_free", {**SHORT, "communication.loss": 0.1})
    axes = list(module._worse_links(lossy))
    assert [(axis.key, axis.values) for axis in axes] == [
        ("communication.loss", (0.1, pytest.approx(0.15)))
    ]
    assert not list(module._worse_links(IN_TIME))


def test_measured_positions_take_the_place_of_the_starts():
    moved = with_starts_at(IN_TIME, {3: (1.0, 2.0, 3.0)})
    assert moved.uav(3).position.tolist() == [1.0, 2.0, 3.0]
    assert moved.uav(2).position.tolist() == IN_TIME.uav(2).position.tolist()
    assert with_starts_at(IN_TIME, {}) is IN_TIME


def test_what_the_dry_run_says_of_a_draw():
    plan = plan_of(TOO_SOON, 2, check=2)
    assert dry_run_says(plan, 0) == "refused"
    assert dry_run_says(plan_of(IN_TIME, 2, check=2), 0) == "accepted"
