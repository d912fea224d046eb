"""Sweeps of the experiments: every case is a scenario, and a table has both largest errors."""

from pathlib import Path

import pytest

from paper import swept
from paper.experiments import ablations, experiment, promise, time_base
from paper.flights import PLANTS, scenario
from paper.output import ExperimentFolder
from paper.swept import SweepCase, swept_table
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.sweep.draws import parse_starts
from ptnsbc_sim.sweep.plan import plan_of

ABLATIONS = [
    *ablations._laws(), *ablations._rules(), *ablations._starts(), *time_base._time_bases(), *time_base._loops(),
    *ablations._adaptations(),
]  # fmt: skip
CAUSES = [SweepCase((name,), *given) for name, given in experiment.CAUSES.items()]
PROMISE = [
    promise.law_case(name, plant, law)
    for name, plants in {**promise.SCENARIOS, "paper_20": PLANTS}.items()
    for plant in plants
    for law in promise.LAWS
]


@pytest.mark.slow
@pytest.mark.parametrize("cases", [PROMISE, ABLATIONS, CAUSES])
def test_every_case_can_be_drawn(cases: list[SweepCase]) -> None:
    for case in cases:
        base = scenario(case.scenario, case.changes)
        plan_of(base, case.runs, starts=parse_starts(case.starts), family=case.family)


def test_every_table_has_two_hundred_flights() -> None:
    assert all(case.runs >= 200 for case in (*PROMISE, *ABLATIONS, *CAUSES))


def test_a_table_has_its_interval_and_both_largest_errors(tmp_path: Path) -> None:
    output = ExperimentFolder(tmp_path, lambda line: None)
    case = SweepCase(("0.1",), starts="near:0.1", runs=3, stop_after_s=0.5)
    table = swept_table(output, "try", "A try", ("sigma",), [case], "Meaning.")
    heads = [column.title for column in table.columns]
    at = heads.index("largest after tf, 95 %, m")
    assert heads[at + 1] == "the same with excused spans, m"
    assert table.rows[0][0] == "0.1" and str(table.rows[0][1]).endswith("of 3")
    assert "wide" in str(table.rows[0][heads.index("95 % interval")])
    assert (tmp_path / "sweeps" / "try-0-1" / "table.parquet").is_file()


def test_the_approach_is_the_paper_s_where_nothing_is_said() -> None:
    assert scenario("paper_5").formation.approach == "task"
    own = load_scenario("paper_5").formation.approach
    assert scenario("paper_5", swept.DEFAULT_APPROACH).formation.approach == own == "planned"
