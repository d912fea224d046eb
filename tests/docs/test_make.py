"""The made parts of the pages: as the code is now, with every key and option in them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from docs.make import __main__ as command
from docs.make import cli, json_schemas, scenarios, tutorial
from docs.make.markdown import RegionError, region, remade, table
from docs.make.schema import REQUIRED, meanings, rows
from ptnsbc_io.bag import read_bag
from ptnsbc_nodes.comm import topics
from ptnsbc_sim.scenario import load_scenario, model
from ptnsbc_sim.scenario.fields import Block


def _stale(name: str) -> bool:
    return (command.DOCS / name).read_text("utf-8") != command.made(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({*command.PAGES} - {"architecture.md"}))
def test_the_committed_pages_are_what_is_made(name):
    assert not _stale(name), "make docs"


@pytest.mark.ros
def test_the_committed_topics_are_those_of_the_nodes():
    pytest.importorskip("rclpy")
    pytest.importorskip("pymavlink")
    assert not _stale("architecture.md"), "make docs"


def test_the_rates_of_topics_are_those_of_a_recording():
    scenario = load_scenario("paper_5")
    words = {
        topics.CONTROL_RATE: scenario.timing.control_hz,
        topics.SENSOR_RATE: scenario.sensor.rate_hz,
        topics.STATUS_RATE: 5,
        "20 Hz": 20,
    }
    bag = read_bag(command.DOCS.parent / "bags" / "sample")
    counts = {topic.name: topic.messages for topic in bag.topics.values()}
    seconds = counts["/uav1/odom"] / scenario.timing.control_hz
    checked = 0
    for topic in topics.in_bag([1]):
        if topic.rate in words and counts.get(topic.name):
            # Several nodes speak on /diagnostics and all UAVs have frames on /tf.
            speakers = {topics.DIAGNOSTICS.name: 6, topics.TF.name: 5}.get(topic.name, 1)
            rate = counts[topic.name] / seconds / speakers
            assert rate == pytest.approx(words[topic.rate], rel=0.02), topic.name
            checked += 1
    assert checked >= 8


def test_making_twice_changes_nothing():
    page = "# A\n\n<!-- made: one -->\nold\n<!-- /made -->\n\nText.\n"
    once = remade(page, {"one": "new\n"})
    assert once == "# A\n\n<!-- made: one -->\n\nnew\n\n<!-- /made -->\n\nText.\n"
    assert remade(once, {"one": "new\n"}) == once


@pytest.mark.parametrize("regions", [{}, {"two": ""}, {"one": "", "two": ""}])
def test_a_page_and_its_generator_name_the_same_regions(regions):
    with pytest.raises(RegionError, match="expected"):
        remade("<!-- made: one -->\n<!-- /made -->\n", regions)


def test_a_bar_in_a_cell_does_not_end_it():
    assert table(("A", "B"), [("a|b", "")]) == "| A | B |\n|---|---|\n| a\\|b | |\n"


def test_check_says_what_is_stale_and_writes_nothing(tmp_path, monkeypatch, capsys):
    page = tmp_path / "cli.md"
    stale = "".join(f"<!-- made: {name} -->\n<!-- /made -->\n" for name in cli.regions())
    page.write_text(stale, encoding="utf-8")

    monkeypatch.setattr(command, "DOCS", tmp_path)
    monkeypatch.setattr(json_schemas, "SCHEMAS", {})
    monkeypatch.setattr(command, "PAGES", {"cli.md": "docs.make.cli"})
    assert command.main(["--check"]) == 1
    assert page.read_text("utf-8") == stale
    assert command.main([]) == 0
    assert command.main(["--check"]) == 0
    assert "cli.md: made anew" in capsys.readouterr().out


def _blocks(kind: type[Block]) -> Iterator[type[Block]]:
    for below in kind.__subclasses__():
        yield below
        yield from _blocks(below)


def test_every_key_has_a_meaning():
    blocks = set(_blocks(Block))
    assert len(blocks) > 50
    wrong = {block.__name__ for block in blocks if set(meanings(block)) != set(block.model_fields)}
    assert wrong == set()


def test_rows_say_what_the_schema_says():
    found = {row.key: row for row in rows(model.ScenarioFile)}
    assert found["timing.control_hz"][1:5] == ("whole", "Hz", "> 0, ≤ 2000", REQUIRED)
    assert found["world.gust_m_s"][1:5] == ("vector", "m/s", "each ≥ 0", "[0, 0, 0]")
    assert found["world.obstacles[].keep_out_m"][1:5] == ("number", "m", "≥ 0", REQUIRED)
    assert found["formation.offsets_m"][1:5] == ("vector by id", "m", "", "empty")
    assert found["formation.task"].range.startswith("`distance_angles`, ")
    assert found["mavlink.vehicles.N.sysid"][1:5] == ("whole", "", "1 to 254", "none")
    assert found["communication.loss"][1:5] == ("number", "", "≥ 0, < 1", "0")


def _resolved(plant: str) -> dict[str, object]:
    """Every gain of a scenario that sets none but the formation's deadline, dotted."""
    file = load_scenario(
        "paper_5", {"plant.kind": plant, "gains": {"formation": {"deadline_s": 5}}}
    )
    tree = file.gains.model_dump()
    nested = {name: value for name, value in tree.items() if isinstance(value, dict)}
    flat = {
        f"{name}.{key}": value for name, block in nested.items() for key, value in block.items()
    }
    return {**flat, "profile": tree["profile"]}


def _cells(page: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines()[2:]]


@pytest.fixture(scope="module")
def made_scenarios():
    return scenarios.regions()


@pytest.mark.parametrize("plant", scenarios.PLANTS)
def test_defaults_of_gains_are_those_of_a_flight(plant, made_scenarios):
    """By another way than the page is made: through the loader of a scenario."""
    made, flown = made_scenarios, _resolved(plant)
    side = scenarios.PLANTS.index(plant)
    documented = {row[0].strip("`"): row[3] for row in _cells(made["gains"])}
    for loop, *values in _cells(made["loops"]):
        keys = ("deadline_s", "residual", "scale", "kappa_1_s", "profile")
        documented |= {
            f"{loop.strip('`')}.{key}": value for key, value in zip(keys, values, strict=True)
        }
    told = {
        key: cell.split(" / ")[-1 if side else 0].strip("`") for key, cell in documented.items()
    }
    compared = [key for key in told if key in flown and told[key] != "**required**"]
    assert len(compared) > 55
    for key in compared:
        value = flown[key]
        shown = (
            {None: "none", True: "true", False: "false"}.get(value)
            if value is None or isinstance(value, bool)
            else value
        )
        assert told[key] == (f"{shown:g}" if isinstance(shown, int | float) else shown), key


@pytest.mark.slow
@pytest.mark.parametrize("name", tutorial.COMMANDS)
def test_a_transcript_of_the_tutorial_is_one_screen(name):
    shown = tutorial.transcript(*tutorial.COMMANDS[name]).splitlines()[1:]
    assert len(shown) <= 24 and max(map(len, shown)) <= 80


def test_the_transcript_of_the_demo_is_one_screen():
    shown = region(tutorial.PAGE.read_text("utf-8"), tutorial.DEMO).splitlines()[2:-1]
    assert 12 < len(shown) <= 24 and max(map(len, shown)) <= 80


def test_every_command_has_its_options():
    made = cli.regions()
    assert {"check", "simulate", "fleet", "bag-repair"} <= set(made)
    assert "| `--set` | `KEY=VALUE` | |" in made["simulate"]
    assert "| `--lockstep`, `--real-time` | | `--real-time` |" in made["fleet"]
    assert "| `--output`, `-o` | `DIR` |" in made["bag-repair"]
    assert "| `--type` | `px4`, `ardupilot`, `generic` |" in made["autopilot"]
    assert "`ptnsbc bridge [SCENARIO] [OPTIONS]`" in made["bridge"]
    assert "| `--uav` | `N` | **required** |" in made["bridge"]


@pytest.mark.parametrize("path", json_schemas.SCHEMAS, ids=lambda path: path.name)
def test_the_committed_schemas_are_what_is_made(path):
    assert path.read_text("utf-8") == json_schemas.text(path), "make docs"
