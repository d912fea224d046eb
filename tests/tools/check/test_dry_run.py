"""Dry runs as findings: what is refused, and what would mend it."""

from dataclasses import replace

import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.sweep.dry_run import DryFlight, DryRun, Remedy
from ptnsbc_sim.sweep.rows import not_flown
from ptnsbc_tools.check import CheckReport, check, dry_run

SCENARIO = load_scenario("paper_5_free")
GOOD = DryFlight("met", 2, "", 0.01, 0.5)
LATE = DryFlight("missed", 3, "settled after 7.10 s", 0.4, 0.5)
NEAR = DryFlight("violated", 4, "0.400 m from uav3", 0.1, -0.1)


@pytest.fixture
def say(monkeypatch):
    """The findings of flights that nobody flew."""

    def findings(*flights: DryFlight, mended: tuple[Remedy, ...] = ()):
        monkeypatch.setattr(dry_run, "remedies", lambda *_: mended)
        return list(dry_run.findings(SCENARIO, DryRun(flights)))

    return findings


def test_all_met_is_information(say):
    share, room = say(*[GOOD] * 21)
    assert (share.severity, room.severity) == ("info", "info")
    assert share.value.startswith("21 of 21, 100.0 % (at least 84.5 %) met")
    assert room.value == "0.500 m beyond the keep-outs"


def test_a_few_misses_are_a_warning_with_their_cause(say):
    share, worst, _ = say(*[GOOD] * 19, LATE, LATE)
    assert (share.severity, worst.severity) == ("warning", "warning")
    assert (worst.value, worst.advice) == ("UAV 3 missed", "settled after 7.10 s")


@pytest.mark.parametrize("flights", [[GOOD] * 10 + [LATE] * 11, [LATE] + [GOOD] * 20])
def test_too_few_or_the_first_one_is_refused_with_what_mends_it(say, flights):
    cure = Remedy({}, "set gains.formation.deadline_s to at least 6.10 s")
    share = say(*flights, mended=(cure,))[0]
    assert (share.severity, share.advice) == ("error", cure.said)
    assert ("unperturbed flight is not met" in share.value) == (flights[0] is LATE)


def test_without_a_remedy_that_is_said(say):
    assert "nothing" not in say(LATE)[0].advice
    assert "move starts or places apart" in say(LATE)[0].advice


def test_a_keep_out_is_worse_than_a_miss(say):
    share, worst, room = say(*[GOOD] * 19, LATE, NEAR)
    assert (worst.value, room.value) == ("UAV 4 violated", "-0.100 m beyond the keep-outs")
    assert room.severity == "warning"
    assert share.severity == "warning"


def _late(uav: int, arrived_s: float, gave_way_to: str):
    return replace(not_flown(0, ""), uav=uav, arrived_s=arrived_s, gave_way_to=gave_way_to)


CAME = _late(4, 6.2, "boxA,uav2"), _late(2, 9.13, "uav4")
WAY = DryFlight("met late", 2, "", 0.4, 0.5, in_place=3, late=CAME)


def test_who_is_late_is_a_warning_and_stands_in_the_plan(say):
    share, late, _ = say(*[WAY] * 2, GOOD)
    assert share.value.startswith("3 of 3")
    assert (late.severity, late.value) == ("warning", "2 of 5 UAVs in place after the deadline")
    told = dry_run.plan(SCENARIO, [], DryRun((WAY,)))
    assert told["flown"] == (
        "3 in place by 5 s, 2 later because they gave way to boxA and each other, the last at 9.1 s; "
        "least room 0.50 m beyond the keep-outs"
    )


def test_strictly_late_is_refused_and_named_first():
    flights = DryRun((WAY,))
    report = CheckReport(SCENARIO, tuple(dry_run.findings(SCENARIO, flights, strict=True)), flights)
    assert not report.ok
    assert str(next(dry_run.check_report(report))) == (
        f"{SCENARIO.name}: refused: dry run: late: 2 of 5 UAVs in place after the deadline"
    )


def test_flights_are_counted_by_their_verdicts():
    assert dry_run.counts(DryRun((GOOD,) * 4)) == "4 of 4 dry runs met"
    assert dry_run.counts(DryRun((WAY, LATE, WAY))) == "2 of 3 dry runs met late, 1 missed"


def test_the_plan_says_who_meets_what_when():
    scenario = load_scenario("paper_5")
    told = dry_run.plan(scenario, check(scenario), None)
    assert told["deadline"] == "5 s; UAV 3 has 7.97 m to fly to its place and needs 3.17 s"
    assert told["avoids"] == "O1 from 18.0 s (UAV 5, 4); O2 from 36.3 s (UAV 1, 4, 5)"
    assert "flown" not in told
    told = dry_run.plan(load_scenario("mission_6"), [], None)
    assert told["legs"].startswith("form-1 by 7 s, gate by 17 s")
