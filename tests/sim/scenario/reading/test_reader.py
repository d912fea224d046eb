"""Scenario files as trees: JSON files, and values from Python."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ptnsbc_sim.scenario import ScenarioError, load_scenario, scenario_from_text
from ptnsbc_sim.scenario.reading import reader


def test_a_json_file_is_the_same_scenario(tmp_path: Path) -> None:
    whole = load_scenario("paper_5")
    file = tmp_path / "mine.json"
    file.write_text(json.dumps(reader.parse(whole.text, "paper_5")), encoding="utf-8")
    read = load_scenario(file)
    assert read == whole
    assert scenario_from_text(read.text) == whole  # what a bag carries is YAML
    (tmp_path / "child.yaml").write_text("extends: ./mine.json\nseed: 9\n", encoding="utf-8")
    assert load_scenario(tmp_path / "child.yaml").seed == 9


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ('{"seed": 1,}', r"line 1, column 1\d: .*: expected JSON"),
        ('{"seed": 1, "seed": 2}', 'duplicate key "seed"'),
        ('{"seed": NaN}', "NaN: expected a finite number"),
        ("[1]", "list: expected a mapping"),
        ('{"sed": 1}', 'did you mean "seed"'),
        ("[" * 100_000, "not JSON"),
    ],
)
def test_json_that_is_no_scenario_is_one_line(tmp_path: Path, text: str, match: str) -> None:
    file = tmp_path / "mine.json"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=match) as found:
        load_scenario(file)
    assert "mine.json" in str(found.value) and "\n" not in str(found.value)


def test_values_from_python_become_those_of_yaml() -> None:
    given = {"a": np.arange(3), "b": (np.float64(1.5), [np.int64(2)]), np.int64(3): None}
    assert reader.plain(given) == {"a": [0, 1, 2], "b": [1.5, [2]], 3: None}
    assert reader.parse(reader.dump(reader.plain(given)), "x")["b"] == [1.5, [2]]
