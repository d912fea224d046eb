"""Make report.png, the picture of the page in README: `python docs/img/make_report.py BAG`.

Needs Chromium and the extra [dev]. The bag of the README is that of
`ptnsbc simulate paper_5 --bag out/paper_5`.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from ptnsbc_tools.charts.flight import read_shown
from ptnsbc_tools.report.page import page
from ptnsbc_tools.verify import Choice

SIZE = {"width": 1280, "height": 1200}
TIME_S = 20.5  # two UAVs keep clear of an obstacle


def _picture(address: str) -> bytes:
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        tab = browser.new_page(viewport=SIZE, color_scheme="light")
        tab.goto(address)
        tab.wait_for_selector("html[data-ready=true]")
        tab.evaluate("page.views.follow()")
        tab.evaluate(f"page.clock.seek({TIME_S})")
        tab.wait_for_function("() => page.scene.poses && !page.scene.due")
        picture: bytes = tab.screenshot()
        browser.close()
    return picture


def main(bag: Path) -> None:
    """Take the picture."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "index.html")
        file.write_text(page(read_shown(bag, Choice()), {"mode": "headless"}), "utf-8")
        path = Path(__file__).with_name("report.png")
        path.write_bytes(_picture(file.as_uri()))
    print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
