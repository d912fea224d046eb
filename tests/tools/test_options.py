"""The legs of a file in place of those of the scenario, and what its errors name."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools import options

LEGS = "legs:\n  - {kind: form, over_s: 5}\n  - {kind: hold, over_s: 3}\n"


def flown(folder: Path, text: str) -> Scenario:
    file = folder / "my_legs.yaml"
    file.write_text(text, "utf-8")
    context: Any = SimpleNamespace(params={"scenario": "mission_6", "mission": file})
    return options.chosen(context)


@pytest.mark.parametrize("text", [LEGS, "mission:\n" + LEGS.replace("legs", "  legs")])
def test_the_legs_of_a_file_are_flown(tmp_path: Path, text: str) -> None:
    assert [one.name for one in flown(tmp_path, text).legs] == ["form-1", "hold-2"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            LEGS.replace("over_s: 3", "overs: 3"),
            r"mission\.legs\[1\]\.overs: unknown key: did you m",
        ),
        ("- {kind: form, over_s: 5}\n", r"list: expected a mapping that starts with legs:"),
        ("name: mine\nextends: mission_6\n", r"no legs: expected the key legs, or mission with"),
        ("mission: 5\n", r"no legs: expected the key legs, or mission with legs below it"),
    ],
)
def test_what_is_wrong_in_the_file_names_the_file(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(PtnsbcError, match=rf"my_legs\.yaml: {said}"):
        flown(tmp_path, text)
