"""Make report.png, the picture of the page in README: `python docs/img/make_report.py BAG`.

Needs Chromium and the extra [dev]. The bag of the README is that of
`ptnsbc simulate paper_5 --bag out/paper_5`.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

SIZE = {"width": 1280, "height": 1200}
TIME_S = 20.5  # two UAVs keep clear of an obstacle


def main(bag: Path) -> None:
    """Take the picture."""
    path = Path(__file__).with_name("report.png")
    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        folder = Path(name) / "report"
        report = [sys.executable, "-m", "ptnsbc_tools.cli", "report", str(bag), "-o", str(folder)]
        if subprocess.run(report).returncode > 1:  # 1: the deadline was not met
            raise SystemExit(2)
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        tab = browser.new_page(viewport=SIZE, color_scheme="light")
        tab.goto((folder / "index.html").as_uri())
        tab.wait_for_selector("html[data-ready=true]")
        tab.evaluate("page.views.follow()")
        tab.evaluate(f"page.clock.seek({TIME_S})")
        tab.wait_for_function("() => page.scene.poses && !page.scene.due")
        path.write_bytes(tab.screenshot())
        browser.close()
    print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
