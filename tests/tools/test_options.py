"""The legs of a file in place of those of the scenario, what its errors name, and the completion of the shell."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools import options

LEGS = "legs:\n  - {kind: form, over_s: 5}\n  - {kind: hold, over_s: 3}\n"


def flown(folder: Path, text: str) -> Scenario:
    file = folder / "my_legs.yaml"
    file.write_text(text, "utf-8")
    return options.FlightChoices(mission=file).of("mission_6")


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


def test_the_shell_completes_the_names_of_scenarios() -> None:
    every = options.scenario_names("")
    assert {"paper_5", "mission_6"} <= set(every)
    assert options.scenario_names("paper_5") == [one for one in every if one.startswith("paper_5")]
    assert options.scenario_names("nothing") == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("check paper_5_f", ["paper_5_free"]),
        ("simulate nothing", []),
        ("bag rep", ["repair", "replay"]),
    ],
)
def test_the_completion_answers_the_shell(words: str, said: list[str]) -> None:
    asked = {"_PTNSBC_COMPLETE": "complete_bash", "COMP_WORDS": f"ptnsbc {words}"}
    environment = {**os.environ, **asked, "COMP_CWORD": str(len(words.split()))}
    command = [sys.executable, "-m", "ptnsbc_tools"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.stdout.split(), done.stderr) == (said, "")


@pytest.mark.parametrize(
    ("shell", "word"), [("bash", "complete -o"), ("zsh", "compdef"), ("fish", "complete --command")]
)
def test_the_script_of_the_completion_calls_us(shell: str, word: str) -> None:
    # Typer looks for the shell among the parents of the process, and a test may have none there.
    environment = os.environ | {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    command = [sys.executable, "-m", "ptnsbc_tools", "--show-completion", shell]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert word in done.stdout
    assert "_PTNSBC_COMPLETE" in done.stdout


@pytest.mark.parametrize("name", ["paper_5", "experiment_4", "take_off_4", "field_gnss_4"])
def test_a_scenario_flies_on_a_slow_computer(name: str) -> None:
    """The rates of the sensors divide that of the laws, and fixes come on a tick."""
    made, usual = (options.FlightChoices(slow=slow).of(name) for slow in (True, False))
    assert (made.timing.control_hz, made.sensor.rate_hz) == (50, 10)
    assert usual.timing.control_hz == 100
    if usual.sensor.positioning is not None and made.sensor.positioning is not None:
        earlier_s = usual.sensor.positioning.latency_s - made.sensor.positioning.latency_s
        assert -1e-9 < earlier_s < 0.02


def test_a_graph_that_is_too_fast_for_a_slow_computer_is_refused() -> None:
    with pytest.raises(PtnsbcError, match=r"gains.estimator: .* or raise timing.control_hz"):
        options.FlightChoices(slow=True).of("lattice_10")
