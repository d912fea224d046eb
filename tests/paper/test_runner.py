"""Experiments in processes: in order, and with one line when one of them is killed."""

import os
import signal
from pathlib import Path

import pytest

from paper import runner
from paper.catalogue import Experiment
from paper.experiment_result import ExperimentResult, ReproduceError
from paper.output import ExperimentFolder
from paper.runner import ExperimentProgress, run_all


class Quick(Experiment):
    """An experiment that flies nothing; workers find it by this module's name."""

    def load(self):
        return {"one": _part, "two": _part, "timed": _part, "killed": _killed}[self.name]


def _part(output: ExperimentFolder) -> ExperimentResult:
    output.progress("working")
    (output.folder / "made").mkdir(exist_ok=True)
    return ExperimentResult("quick", "Quick", str(os.getpid()))


def _killed(output: ExperimentFolder) -> ExperimentResult:
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def quick(name: str, seconds: float, alone: bool = False) -> Quick:
    return Quick(name, "nothing", seconds, alone)


@pytest.mark.slow
def test_results_come_in_the_order_given_and_timed_ones_are_run_last(tmp_path: Path) -> None:
    told: list[ExperimentProgress] = []
    given = [quick("timed", 9, alone=True), quick("one", 1), quick("two", 2)]
    made = run_all(given, tmp_path, 1, told.append)
    assert len(made) == 3
    assert all(int(one.part.text) != os.getpid() for one in made)
    assert [news.experiment for news in told if news.done] == ["two", "one", "timed"]


def test_a_process_that_is_killed_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ReproduceError, match="killed: a process of this run was killed"):
        run_all([quick("killed", 1)], tmp_path, 1, lambda news: None)


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch) -> None:
    class Failed:
        def result(self):
            raise OSError(28, "No space left on device")

    with pytest.raises(ReproduceError, match="No space left"):
        runner._result(Failed(), "one")
