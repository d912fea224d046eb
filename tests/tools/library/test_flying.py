"""Loading, checking and flying from Python."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import ptnsbc
from ptnsbc_sim.scenario import ScenarioError, load_scenario
from ptnsbc_tools.check import CheckError
from ptnsbc_tools.library.flying import check, fly, load, read_bag, verdict

QUICK = {"timing.duration_s": 1.2, "gains.formation.deadline_s": 0.9}
QUICK_KEYS = {"timing": {"duration_s": 1.2}, "gains": {"formation": {"deadline_s": 0.9}}}


def test_a_mapping_is_a_scenario_file() -> None:
    made = load({"extends": "paper_5", "seed": np.int64(3), "timing": {"duration_s": "2 s"}})
    assert (made.seed, made.timing.duration_s, made.uav_ids) == (3, 2.0, (1, 2, 3, 4, 5))


def test_keys_are_set_from_python_values() -> None:
    place = np.array([1.0, 2.0, 3.0])
    made = load("paper_5").with_({"uavs[0].position_m": place, "gains.profile": "paper"}, seed=7)
    np.testing.assert_array_equal(made.uav(1).position, place)
    assert (made.gains.profile, made.seed) == ("paper", 7)
    assert load("paper_5", seed=7).text == load_scenario("paper_5", {"seed": 7}).text


@pytest.mark.parametrize("value", [object(), {1, 2}, 1j])
def test_what_yaml_cannot_hold_is_refused(value: object) -> None:
    with pytest.raises(ScenarioError, match="expected a number, text, a list or a mapping"):
        load("paper_5").with_({"seed": value})


def test_an_unknown_key_names_the_known_one() -> None:
    with pytest.raises(ScenarioError, match='did you mean "seed"'):
        load("paper_5").with_(sed=3)


def test_what_is_no_scenario_is_refused_in_words() -> None:
    for value in (None, 5, np.zeros(3)):
        with pytest.raises(ScenarioError, match="expected a scenario, its name or file"):
            fly(value)  # type: ignore[arg-type]
    with pytest.raises(ScenarioError, match='with_: "a=1": expected values by dotted key'):
        load("paper_5").with_("a=1")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        *(
            (partial(function, None), "None: expected a path")
            for function in (
                ptnsbc.read_bag,
                ptnsbc.verdict,
                ptnsbc.report,
                ptnsbc.open_sweep,
                ptnsbc.rerun,
                ptnsbc.repair,
                ptnsbc.new,
                partial(ptnsbc.export, file="a.csv"),
            )
        ),
        (partial(ptnsbc.verdict, "bags/sample", 10**400), "tolerance_m: 1000000"),
        (partial(ptnsbc.doctor, "paper5"), 'did you mean "paper_5"'),
        (partial(ptnsbc.sweep, "paper_5", None), "runs: 0: expected a whole number, 1 to"),
        (partial(ptnsbc.sweep, "paper_5", seed="x"), "seed: 'x': expected a whole number, 0 to"),
        (partial(ptnsbc.sweep, "paper_5", workers=0), "workers: 0: expected a whole number, 1 to"),
        (partial(ptnsbc.sweep, "paper_5", stop_after_s="x"), "stop_after_s: 'x': expected 0 to"),
        (partial(ptnsbc.compare, 1, 2, margin_m=-1), "margin_m: -1: expected 0 to"),
        (partial(ptnsbc.load("paper_5").with_, {1: 2}), "1: unknown key"),
    ],
)
def test_what_is_no_argument_is_named(call: Callable[[], object], words: str) -> None:
    with pytest.raises(ptnsbc.PtnsbcError, match=words):
        call()


def test_the_check_says_ok_or_refuses() -> None:
    good = check(load("paper_5"), dry_runs=0)
    assert good.ok and len(good) == len(list(good))
    bad = check(load("paper_5").with_({"gains.formation.deadline_s": 2}))
    assert not bad.ok
    with pytest.raises(CheckError, match=r"deadline_s: 2 s"):
        bad.refuse()


@pytest.mark.parametrize(
    "named", ["paper_5", Path("scenarios/paper_5.yaml"), {"extends": "paper_5"}]
)
def test_every_function_takes_what_load_takes(named: str | Path | dict[str, str]) -> None:
    assert check(named, dry_runs=0).findings == check(load("paper_5"), dry_runs=0).findings
    flown = (
        {"extends": str(named), **QUICK_KEYS} if isinstance(named, str) else load(named, **QUICK)
    )
    assert fly(flown, checked=False).scenario.timing.duration_s == 1.2
    with pytest.raises(ScenarioError, match="paper_55"):
        fly("paper_55")


def test_a_flight_is_refused_or_flown(capsys: pytest.CaptureFixture[str]) -> None:
    quick = load("paper_5").with_(QUICK)
    with pytest.raises(CheckError):
        fly(quick)
    flight = fly(quick, checked=False, progress=False)
    assert verdict(flight) is flight.verdict
    assert verdict(flight, 100.0).uavs[0].tolerance_m == 100.0
    assert capsys.readouterr().out == ""


def test_a_warning_of_the_check_is_a_python_warning() -> None:
    crowded = load("paper_5").with_({"timing.duration_s": 0.1, "gains.profile": "paper"})
    assert any(one.severity == "warning" for one in check(crowded, dry_runs=0))
    with pytest.warns(UserWarning, match=r"paper_5: gains\.profile"):
        fly(crowded)


def test_the_sample_bag() -> None:
    flight = read_bag("bags/sample", window_s=2.0)
    assert flight.time_s[-1] <= 2.0
    assert verdict("bags/sample").verdict == "met"
    assert flight.bag is not None and flight.uavs == flight.scenario.uav_ids
