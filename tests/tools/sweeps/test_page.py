"""The page of a sweep: one file, its pictures inside."""

from __future__ import annotations

import shutil
from pathlib import Path

from ptnsbc_tools.sweeps.page import write_report
from ptnsbc_tools.sweeps.table import read_sweep


def test_the_page_holds_tables_commands_and_pictures(flown: Path, tmp_path: Path) -> None:
    folder = tmp_path / "small"
    shutil.copytree(flown, folder)
    page = write_report(read_sweep(folder))
    text = page.read_text(encoding="utf-8")
    assert page == folder / "report" / "index.html"
    assert "Flights met: " in text
    assert f"ptnsbc simulate --sweep {folder} --draw " in text
    pictures = sorted(page.parent.glob("*.png"))
    assert text.count("data:image/png;base64,") == len(pictures) >= 4
    assert all(picture.read_bytes().startswith(b"\x89PNG") for picture in pictures)
    assert not list(page.parent.glob(".*"))
    assert write_report(read_sweep(folder)).read_text(encoding="utf-8") == text
