"""`ptnsbc simulate`: the picture of its flight."""

from __future__ import annotations

import json
from pathlib import Path

from typer.testing import CliRunner

from ptnsbc_tools.cli import app


def test_the_picture_is_drawn_and_named(tmp_path: Path) -> None:
    picture = tmp_path / "flight.png"
    words = ["simulate", "paper_5_free", "--duration", "6", "--json", "--picture", str(picture)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0
    assert json.loads(result.stdout)["picture"] == str(picture)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 10_000


def test_a_picture_of_another_kind_is_refused(tmp_path: Path) -> None:
    words = ["simulate", "paper_5_free", "--duration", "1", "--picture", str(tmp_path / "a.xyz")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert "a.xyz" in result.stderr and ".png" in result.stderr
    assert not list(tmp_path.iterdir())
