"""The folder of results: refused when it holds other things, whole or not there at all."""

import json
from pathlib import Path

import pytest

from paper.experiment_result import ReproduceError
from paper.output import RESULTS, check_free, temporary_folder


def results(folder: Path, *names: str) -> Path:
    folder.mkdir()
    (folder / RESULTS).write_text(json.dumps({"parts": [{"name": name} for name in names]}))
    return folder


def test_new_empty_or_own_folders_are_taken(tmp_path: Path) -> None:
    check_free(tmp_path / "new", ["a"])
    check_free(tmp_path, ["a"])
    check_free(results(tmp_path / "own", "a"), ["a", "b"])


def test_other_things_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(ReproduceError, match="holds other things than results"):
        check_free(tmp_path, ["a"])
    with pytest.raises(ReproduceError, match="is a file"):
        check_free(tmp_path / "file", ["a"])


def test_a_part_does_not_replace_the_whole(tmp_path: Path) -> None:
    with pytest.raises(ReproduceError, match="holds results of b"):
        check_free(results(tmp_path / "own", "a", "b"), ["a"])


def test_what_fails_leaves_nothing(tmp_path: Path) -> None:
    goal = results(tmp_path / "goal", "a")
    with pytest.raises(KeyboardInterrupt), temporary_folder(goal) as place:
        (place / "half").write_text("x")
        raise KeyboardInterrupt
    assert [path.name for path in tmp_path.iterdir()] == ["goal"]
    assert [path.name for path in goal.iterdir()] == [RESULTS]


def test_what_is_done_takes_its_place(tmp_path: Path) -> None:
    goal = results(tmp_path / "sub", "a")
    with temporary_folder(goal) as place:
        (place / "whole").write_text("x")
    assert [path.name for path in tmp_path.iterdir()] == ["sub"]
    assert [path.name for path in goal.iterdir()] == ["whole"]
    assert goal.stat().st_mode & 0o777 == tmp_path.joinpath("sub").stat().st_mode & 0o777


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with (
        pytest.raises(ReproduceError, match="expected a place to write"),
        temporary_folder(tmp_path / "file" / "goal"),
    ):
        pass
