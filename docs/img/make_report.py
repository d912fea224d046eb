"""Make the picture of the report: `python docs/img/make_report.py [BAG]`. Needs Chromium and `make setup-test`."""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

SIZE = {"width": 1280, "height": 1200}
TIME_S = 20.5  # two UAVs keep clear of an obstacle
SCENARIO = "paper_5"
HERE = Path(__file__).parent


def main(bags: list[Path]) -> None:
    """Take the picture."""
    with tempfile.TemporaryDirectory() as folder_name:
        folder = Path(folder_name)
        bag = bags[0] if bags else flown(folder)
        with sync_playwright() as driver:
            browser = driver.chromium.launch(
                executable_path=shutil.which("chromium"), args=["--no-sandbox"]
            )
            tab = opened(browser, bag, folder)
            save(Image.open(io.BytesIO(tab.screenshot())), HERE / "report.png")
            browser.close()


def flown(folder: Path) -> Path:
    """The bag of a headless flight."""
    bag = folder / SCENARIO
    words = ["simulate", SCENARIO, "--bag", str(bag)]
    subprocess.run([sys.executable, "-m", "ptnsbc_tools", *words], check=True)
    return bag


def opened(browser: Any, bag: Path, folder: Path) -> Any:
    """The report of a bag in the browser, at TIME_S, with all its figures."""
    page = folder / f"{bag.name}-report"
    report = [sys.executable, "-m", "ptnsbc_tools", "report", str(bag), "-o", str(page)]
    subprocess.run(report, check=True)
    tab = browser.new_page(viewport=SIZE, color_scheme="light")
    tab.goto((page / "index.html").as_uri())
    tab.wait_for_selector("html[data-ready=true]")
    tab.evaluate("page.views.follow()")
    tab.evaluate(f"page.clock.seek({TIME_S})")
    tab.wait_for_function("() => page.figures.charts.every((one) => one.drawn)")
    tab.wait_for_function("() => page.scene.poses && !page.scene.due")
    return tab


def save(picture: Image.Image, path: Path) -> None:
    """A picture of 256 colours: a third of the bytes."""
    few = picture.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1)
    few.save(path, optimize=True)
    print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:2]])
