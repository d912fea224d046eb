"""Help without parsing and verdicts without the compiler: the same text, and no library that is not needed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main
from typer.testing import CliRunner

from ptnsbc_tools.cli import app

GROUPS = ("bag", "network")
COMMANDS = typer.main.get_command(app).commands


def _paths() -> list[tuple[str, ...]]:
    single = [(name,) for name in COMMANDS]
    return single + [(name, inner) for name in GROUPS for inner in COMMANDS[name].commands]


@pytest.mark.parametrize("path", _paths(), ids=" ".join)
def test_every_command_has_help_by_both_names(path: tuple[str, ...]) -> None:
    short, long = (CliRunner().invoke(app, [*path, word]) for word in ("-h", "--help"))
    assert (short.exit_code, long.exit_code) == (0, 0)
    assert short.stdout == long.stdout and f"ptnsbc {' '.join(path)}" in short.stdout.replace(
        "root", "ptnsbc"
    )


def test_help_after_other_words_and_not_after_the_end_of_options() -> None:
    assert CliRunner().invoke(app, ["check", "paper_5", "--seed", "x", "-h"]).exit_code == 0
    assert CliRunner().invoke(app, ["check", "--", "-h"]).exit_code == 2


@pytest.mark.parametrize("path", _paths(), ids=" ".join)
def test_no_word_of_a_help_is_taken_for_markup(path: tuple[str, ...]) -> None:
    """Rich leaves out what stands in brackets, as a unit or the name of an extra."""
    command = COMMANDS[path[0]]
    for name in path[1:]:
        command = command.commands[name]
    texts = [command.help, *(getattr(one, "help", None) for one in command.params)]
    assert not [text for text in texts if text and re.search(r"\[[a-z#/@]", text)]


def test_paragraphs_are_wrapped_by_the_terminal() -> None:
    out = CliRunner().invoke(app, ["compare", "-h"], env={"COLUMNS": "200"}).stdout
    assert "when the largest error after the deadline has grown in the median" in out


def test_the_commands_are_in_groups() -> None:
    out = CliRunner().invoke(app, ["-h"]).stdout
    places = [out.index(word) for word in ("Begin", "Fly", "Look at flights", "Bags", "Processes")]
    assert places == sorted(places)


def test_help_loads_neither_the_laws_nor_what_parses_options() -> None:
    code = (
        "import sys\nfrom ptnsbc_tools.cli import app\n"
        "try:\n    app(['check', '--help'], prog_name='ptnsbc')\nexcept SystemExit:\n    pass\n"
        "heavy = {'numba', 'numpy', 'pydantic', 'scipy', 'matplotlib', 'rclpy'} & set(sys.modules)\n"
        "print(sorted(heavy), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "[]\n"


@pytest.mark.parametrize(
    "path", [(), ("check",), ("bag", "trim"), ("no-such-command",)], ids=" ".join
)
def test_the_program_alone_says_the_same_as_with_all_commands(path: tuple[str, ...]) -> None:
    alone = subprocess.run(
        [sys.executable, "-m", "ptnsbc_tools", *path, "-h"],
        capture_output=True,
        text=True,
        env={**os.environ, "COLUMNS": "80", "TERM": "dumb"},
    )
    with_all = CliRunner().invoke(
        app, [*path, "-h"], prog_name="ptnsbc", env={"COLUMNS": "80", "TERM": "dumb"}
    )
    assert (alone.returncode, alone.stdout) == (with_all.exit_code, with_all.stdout)
    assert alone.stderr == with_all.stderr


def test_a_short_recording_is_judged_without_the_compiler_and_with_the_same_words(
    tmp_path: Path,
) -> None:
    bag = tmp_path / "bag"
    done = CliRunner().invoke(app, ["simulate", "paper_5", "--duration", "0.5", "--bag", str(bag)])
    assert done.exit_code in (0, 1), done.output
    code = (
        "import sys\nfrom ptnsbc_tools.cli import app\n"
        "try:\n    app(sys.argv[1:], prog_name='ptnsbc')\nexcept SystemExit:\n    pass\n"
        "print('numba' in sys.modules, file=sys.stderr)"
    )
    said = {}
    for how in ({}, {"PTNSBC_JIT": "1"}):
        words = [sys.executable, "-c", code, "verify", str(bag), "--json"]
        environment = {name: text for name, text in os.environ.items() if name != "PTNSBC_JIT"}
        run = subprocess.run(words, capture_output=True, text=True, env=environment | how)
        said[run.stderr.splitlines()[-1]] = run.stdout
    assert said["False"] == said.get("True", said["False"])  # numba may not be installed
    assert '"verdict": ' in said["False"]
