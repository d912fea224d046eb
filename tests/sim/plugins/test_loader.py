"""A plug-in is loaded, compiled or interpreted, and a wrong one is named with file and line: shown with laws."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ptnsbc_core.kernel import COMPILED
from ptnsbc_sim.plugins.hooks import HOOKS, LawInputs
from ptnsbc_sim.plugins.loader import Plugin, PluginError, load_plugin
from ptnsbc_sim.scenario import ScenarioError, load_scenario, scenario_from_text
from ptnsbc_sim.swarm import fly

EXAMPLES = Path(__file__).parents[3] / "examples" / "laws"
_EXAMPLE: LawInputs = HOOKS["law"].example[0]

Write = Callable[..., str]


def _law(named: str) -> Plugin:
    return load_plugin("law", named)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """A law file with these lines; returns FILE.py:law."""

    def written(*lines: str) -> str:
        file = tmp_path / "mine.py"
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return f"{file}:law"

    return written


def drawn(seed: int, senders: int = 3) -> LawInputs:
    rng = np.random.default_rng(seed)
    given = {name: rng.normal(size=(senders, 3)) for name in ("positions", "velocities", "offsets")}
    own = {name: rng.normal(size=3) for name in ("position", "velocity", "offset")}
    return _EXAMPLE._replace(
        t=1.5,
        ids=np.arange(senders),
        ages_s=rng.uniform(0.0, 0.1, senders),
        near=rng.normal(size=(4, 8)),
        **given,
        **own,
    )


@pytest.mark.parametrize("name", ["consensus", "potential_field", "integral", "cbf_qp"])
@pytest.mark.parametrize("seed", range(5))
def test_the_compiled_law_is_the_interpreted_one(name: str, seed: int) -> None:
    """Also the functions of its file that it calls, and its memory."""
    law = _law(f"{EXAMPLES / name}.py:{name}")
    assert (law.address > 0) == COMPILED
    inputs = drawn(seed)._replace(memory=np.arange(float(len(law.memory))))
    given = law.function(inputs)
    plain = np.concatenate(given) if law.memory else given
    np.testing.assert_allclose(law.numbers(inputs, at="t"), plain, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        (
            ("import json", "def law(inputs):", "    return json.loads('[1, 2, 3]')"),
            "mine.py:3: numba does not know loads: return json.loads('[1, 2, 3]')",
        ),
        (
            ("", "def law(inputs):", "    global last", "    last = 3", "    return (1, 2, 3)"),
            "mine.py:4: numba cannot compile it: last = 3",
        ),
        (
            (
                "import numpy as np",
                "def mean(rows):",
                "    return np.mean(rows, axis=0)",
                "def law(inputs):",
                "    return mean(inputs.positions) * np.array([1.0, 2.0, 3.0])",
            ),
            "mine.py:3: numba has no axis here: return np.mean(rows, axis=0)",
        ),
        (
            (
                "def law(inputs):",
                "    x = 'a'",
                "    if inputs.t < 9.0:",
                "        x = 1.0",
                "    return (x, 2.0, 3.0)",
            ),
            "mine.py:5: x is of two types: return (x, 2.0, 3.0)",
        ),
    ],
)
def test_what_numba_cannot_compile_is_interpreted_with_a_word(
    write: Write, capsys: pytest.CaptureFixture[str], lines: tuple[str, ...], why: str
) -> None:
    """The line and the reason are ours: numba shows the types of all inputs."""
    law = _law(write(*lines))
    assert law.numbers(_EXAMPLE, at="t") == (1.0, 2.0, 3.0)
    said = capsys.readouterr().err
    assert not COMPILED or (f"{why}: law is interpreted, " in said and said.count("\n") == 1)


@pytest.mark.parametrize("memory", ["1.0", "('a',)", "(float('nan'),)", "(0.0,) * 1001"])
def test_a_memory_of_something_else_is_refused(write: Write, memory: str) -> None:
    with pytest.raises(PluginError, match=r"mine\.py:1: law: memory = .*at most 1000 finite"):
        _law(write("def law(inputs):", "    return inputs.position, ()", f"law.memory = {memory}"))


def test_a_law_that_forgets_its_memory_is_refused(write: Write) -> None:
    law = _law(write("def law(inputs):", "    return inputs.position", "law.memory = (1.0, 2.0)"))
    expected = "velocity of three numbers .*, and beside it its memory of 2 numbers"
    with pytest.raises(PluginError, match=rf"mine\.py:1: law: returned .*: expected a {expected}"):
        law.numbers(_EXAMPLE._replace(memory=np.array([1.0, 2.0])), at="t")


@pytest.mark.parametrize(
    ("lines", "match"),
    [
        (("def law(inputs):", "    a = 1.0", "    return a"), r"mine\.py:1: law: returned 1\.0: "),
        (
            ("def law(inputs):", "    return (0.0, 1.0)"),
            r"returned .*: expected a velocity of three",
        ),
        (
            ("import math", "def law(inputs):", "    return (math.nan, 0.0, 0.0)"),
            r"mine\.py:2: law: returned \(nan, 0, 0\) at t = 0\.000 s: expected finite",
        ),
        (
            ("def law(inputs):", "    raise ValueError('no way')", "    return (0.0, 0.0, 0.0)"),
            r"mine\.py:2: law: ValueError: no way",
        ),
        (
            ("def law(inputs):", "    a = 1.0 / (inputs.t - inputs.t)", "    return (a, a, a)"),
            r"mine\.py:2: law: ZeroDivisionError",
        ),
        (
            ("def law(inputs):", "    return inputs.pos"),
            r"mine\.py:2: law: AttributeError: .* 'pos': did you mean position\?$",
        ),
        (
            ("import json", "def law(inputs):", "    x = json.loads('1')", "    return x[3]"),
            r"mine\.py:4: law: TypeError",
        ),
    ],
)
def test_a_law_that_gives_no_velocity_names_its_line(
    write: Write, capsys: pytest.CaptureFixture[str], lines: tuple[str, ...], match: str
) -> None:
    law = _law(write(*lines))
    with pytest.raises(PluginError, match=match):
        law.numbers(_EXAMPLE, at="t = 0.000 s")
    assert capsys.readouterr().err == ""  # nothing of the compiler


@pytest.mark.parametrize(
    ("lines", "match"),
    [
        (("def law(inputs:",), r"mine\.py:1: "),
        (("import numpy", "import no_such_module"), r"mine\.py:2: ModuleNotFoundError"),
        (("other = 3",), r"law: no such name: expected a function"),
        (("law = 3",), r"law: int: expected a function"),
        (("def law(a, b):", "    return a"), r"mine\.py:1: law: missing a required argument: 'b'"),
    ],
)
def test_a_file_without_a_law_names_its_line(
    write: Write, lines: tuple[str, ...], match: str
) -> None:
    with pytest.raises(PluginError, match=match):
        _law(write(*lines))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match=r"nowhere\.py: No such file"):
        _law(f"{tmp_path}/nowhere.py:law")


def test_the_file_is_looked_for_beside_the_scenario(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("extends: paper_5_free\nlaw: laws/a.py:law\n")
    (tmp_path / "child.yaml").write_text("extends: ./mine.yaml\nname: child\n")
    for name in ("mine", "child"):
        read = load_scenario(tmp_path / f"{name}.yaml")
        assert read.law == f"{tmp_path}/laws/a.py:law"
        assert scenario_from_text(read.text).law == read.law  # as a process of a fleet reads it


def test_a_scenario_from_a_bag_names_no_file_to_execute(write: Write, tmp_path: Path) -> None:
    mark = tmp_path / "executed"
    named = write(f"open({str(mark)!r}, 'w').close()", "def law(inputs):", "    return (0, 0, 0)")
    text = load_scenario("paper_5_free", {"law": named}).text
    carried = scenario_from_text(text, complete=True)
    assert carried.law == "mine.py:law"
    for scenario in (carried, carried.with_({"timing.duration_s": 1})):
        with pytest.raises(PluginError, match="a bag names a law and does not carry it"):
            fly(scenario)
    assert not mark.exists()
    assert carried.with_(law=named).law == named  # given by the user


@pytest.mark.parametrize(
    ("keys", "match"),
    [
        ({"law": "mine.txt:law"}, r"law: .*expected FILE\.py:NAME"),
        ({"law": "mine.py"}, r"law: .*expected FILE\.py:NAME"),
        (
            {"law": "mine.py:law", "formation.vacancy": "keep"},
            r"law: .*mine\.py:law: expected none beside formation\.vacancy: keep or close_up",
        ),
    ],
)
def test_a_key_that_names_no_law_is_refused(keys: dict[str, str], match: str) -> None:
    with pytest.raises(ScenarioError, match=match):
        load_scenario("paper_5_free", keys)
