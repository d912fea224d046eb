"""A flight by a law of the user, run again: equal with the file, refused without it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from ptnsbc_io.bag import read_bag
from ptnsbc_sim.plugins.loader import PluginError
from ptnsbc_tools.cli import app
from ptnsbc_tools.library.flying import fly, load
from ptnsbc_tools.reading.bag_reader import scenario_of
from ptnsbc_tools.replay.rerun import rerun

LAW = Path(__file__).parents[3] / "examples" / "laws" / "consensus.py"
INTEGRAL = f"{LAW.with_name('integral.py')}:integral"


def _flown(folder: Path, law: str, **keys: Any) -> Path:
    pytest.importorskip("rclpy")
    changes = {key.replace("__", "."): value for key, value in keys.items()}
    scenario = load("paper_5_free").with_({"timing.duration_s": 1.2, **changes}, law=law)
    fly(scenario, checked=False).save(folder / "bag")
    return folder / "bag"


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(0.0, id="all arrive"),
        pytest.param(0.2, id="some get lost", marks=pytest.mark.slow),
    ],
)
def bag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("law")
    return _flown(folder, f"{LAW}:consensus", communication__loss=request.param)


@pytest.mark.slow
@pytest.mark.parametrize(
    "keys",
    [
        {"formation__assignment": "optimal", "formation__turn_rad": 0},
        {
            "formation__frame": "heading",
            "formation__task": "relative_position",
            "leader__trajectory__heading": "path",
            "formation__changes": [{"at_s": 0.4, "over_s": 5, "scale": [1.5, 1.5, 1]}],
        },
    ],
    ids=["open slots", "places that move"],
)
def test_a_law_with_a_memory_gives_the_same_bytes(tmp_path: Path, keys: dict[str, Any]) -> None:
    """What a kernel flew for all UAVs at once, the controller of each flies by its messages."""
    bag = _flown(tmp_path, INTEGRAL, **keys)
    code, out, _ = _rerun(bag, "--plugin", INTEGRAL, "--json")
    assert (code, json.loads(out)["verdict"]) == (0, "equal")


def _rerun(*words: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["bag", "replay", *map(str, words), "--rerun"])
    return result.exit_code, result.stdout, result.stderr


def test_the_file_gives_the_same_bytes(bag: Path) -> None:
    code, out, _ = _rerun(bag, "--plugin", f"{LAW}:consensus", "--json")
    assert (code, json.loads(out)["verdict"]) == (0, "equal")


def test_another_law_of_this_name_gives_others(bag: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.py"
    other.write_text(LAW.read_text("utf-8").replace("GAIN_1_S = 2.0", "GAIN_1_S = 1.0"), "utf-8")
    assert _rerun(bag, "--plugin", f"{other}:consensus")[0] == 1


def test_without_the_file_nothing_is_executed(bag: Path) -> None:
    code, out, err = _rerun(bag)
    assert (code, out) == (2, "")
    assert "consensus.py:consensus, which a bag does not carry: give the plugin" in err
    read = read_bag(bag)
    with pytest.raises(PluginError, match="a bag names a law and does not carry it"):
        rerun(read, scenario_of(read, None))


def test_the_verdict_needs_no_law(bag: Path) -> None:
    result = CliRunner().invoke(app, ["verify", str(bag), "--json"])
    assert json.loads(result.stdout)["scenario"] == "paper_5_free"


PLUGINS = LAW.parents[1] / "plugins"


@pytest.mark.slow
def test_a_task_and_a_controller_are_given_by_name(tmp_path: Path) -> None:
    """What surrounds the UAVs is recorded: plant, disturbance and sensor are not needed again."""
    pytest.importorskip("rclpy")
    flown = fly(load(PLUGINS / "all.yaml").with_({"timing.duration_s": 0.6}), checked=False)
    flown.save(tmp_path / "bag")
    code, out, err = _rerun(tmp_path / "bag", "--plugin", f"{PLUGINS}/cylinder.py:cylinder")
    assert (code, out) == (2, "")
    assert (
        "flown with the controller proportional.py:proportional, which a bag does not carry" in err
    )
    both = [f"{PLUGINS}/{name}.py:{name}" for name in ("cylinder", "proportional")]
    words = [word for one in both for word in ("--plugin", one)]
    code, out, _ = _rerun(tmp_path / "bag", *words, "--json")
    assert (code, json.loads(out)["verdict"]) == (0, "equal")
