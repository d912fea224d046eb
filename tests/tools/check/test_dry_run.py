"""Dry runs as findings: what is refused, and what would mend it."""

import pytest

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.sweep import dry_run as engine
from ptnsbc_sim.sweep.dry_run import DryFlight, DryRun, Remedy
from ptnsbc_tools.check import dry_run

SCENARIO = load_scenario("paper_5_free")
GOOD = DryFlight("met", 2, "", 0.01, 0.5)
LATE = DryFlight("missed", 3, "settled after 7.10 s", 0.4, 0.5)
NEAR = DryFlight("violated", 4, "0.400 m from uav3", 0.1, -0.1)


@pytest.fixture
def say(monkeypatch):
    """The findings of flights that nobody flew."""

    def findings(*flights: DryFlight, mended: tuple[Remedy, ...] = ()):
        monkeypatch.setattr(dry_run, "dry_run", lambda *_, **__: DryRun(flights))
        monkeypatch.setattr(dry_run, "remedies", lambda *_: mended)
        return dry_run.flown(SCENARIO)

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


def test_the_engine_is_the_one_of_sweeps():
    assert dry_run.dry_run is engine.dry_run
