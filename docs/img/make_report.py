"""Make the pictures of the page: `python docs/img/make_report.py BAG BAG20`.

report.png is the one in README, report_20.png that of 20 UAVs, report_print.png what is printed of the first.

Needs Chromium and the extra [dev]. The bag of the README is that of
`ptnsbc simulate paper_5 --bag out/paper_5`.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

SIZE = {"width": 1280, "height": 1200}
PAPER = {"width": 760, "height": 1075}  # A4 within its margins
TIME_S = 20.5  # two UAVs keep clear of an obstacle


def main(bag: Path, many: Path) -> None:
    """Take the pictures."""
    take(bag, "report.png")
    take(many, "report_20.png")
    take(bag, "report_print.png", on_paper=True)


def take(bag: Path, name: str, on_paper: bool = False) -> None:
    """One picture of the page of a bag."""
    path = Path(__file__).with_name(name)
    with tempfile.TemporaryDirectory() as folder_name, sync_playwright() as driver:
        folder = Path(folder_name) / "report"
        report = [sys.executable, "-m", "ptnsbc_tools.cli", "report", str(bag), "-o", str(folder)]
        if subprocess.run(report).returncode > 1:  # 1: the deadline was not met
            raise SystemExit(2)
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        tab = browser.new_page(viewport=PAPER if on_paper else SIZE, color_scheme="light")
        tab.goto((folder / "index.html").as_uri())
        tab.wait_for_selector("html[data-ready=true]")
        tab.evaluate("page.views.follow()")
        tab.evaluate(f"page.clock.seek({TIME_S})")
        tab.wait_for_function("() => page.scene.poses && !page.scene.due")
        if on_paper:
            tab.wait_for_function("() => page.figures.charts.every((one) => one.drawn)")
            tab.emulate_media(media="print")
        save(tab.screenshot(full_page=on_paper), path)
        browser.close()


def save(png: bytes, path: Path) -> None:
    """A picture of 256 colours: a third of the bytes."""
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    picture.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
