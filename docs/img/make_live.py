"""Make live.png and dashboard_80.svg: `python docs/img/make_live.py`.

It flies paper_5 in lock-step with `--view` and looks at the page shortly before the deadline. Needs Chromium, ROS and
`make setup-test`.
"""

from __future__ import annotations

import io
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

from ptnsbc_sim.scenario import load_scenario
from ptnsbc_tools.console import recording
from ptnsbc_tools.live.dashboard import picture

SIZE = {"width": 1280, "height": 1440}  # down to the legend of the figure
SCENARIO = "paper_5"
SHOWN_S = 3.0
WIDTH = 80  # columns of the table
HERE = Path(__file__).parent
# The page gets the first frame at or after this time, and none after it.
FREEZE = """{
  const Socket = window.WebSocket;
  window.WebSocket = class extends Socket {
    set onmessage(take) {
      super.onmessage = (event) => {
        if (window.shown) return;
        take(event);
        const told = JSON.parse(event.data);
        if (told.kind === "frame" && told.t >= SHOWN_S && told.uavs[0].mode) window.shown = told;
      };
    }
  };
}"""


def main() -> None:
    """Take the pictures."""
    command = [
        sys.executable,
        "-m",
        "ptnsbc_tools",
        "fleet",
        SCENARIO,
        "--lockstep",
        "--view",
        "--plain",
    ]
    environment = {k: v for k, v in os.environ.items() if k != "ROS_DOMAIN_ID"}
    with sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )  # first: it is to look before the flight begins
        tab = browser.new_page(viewport=SIZE, color_scheme="light")
        tab.add_init_script(FREEZE.replace("SHOWN_S", str(SHOWN_S)))
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment) as fleet:
            try:
                assert fleet.stderr is not None
                address = next(line for line in fleet.stderr if "live view: " in line).split()[-1]
                frame = photograph(tab, address, HERE / "live.png")
            finally:
                fleet.send_signal(signal.SIGINT)
                fleet.communicate()
        browser.close()
    console = recording(io.StringIO(), WIDTH)
    console.print(picture(frame, load_scenario(SCENARIO), WIDTH))
    console.save_svg(str(HERE / f"dashboard_{WIDTH}.svg"), title=f"ptnsbc fleet {SCENARIO}")


def photograph(tab: Any, address: str, path: Path) -> dict[str, Any]:
    """Save the page at SHOWN_S; returns the frame that it shows."""
    tab.goto(address)
    tab.wait_for_function("() => window.shown && page.figures.charts[0].drawn", timeout=180_000)
    tab.evaluate("page.figures.refresh()")
    tab.wait_for_timeout(1000)  # the figure is drawn meanwhile
    save(tab.screenshot(), path)
    frame: dict[str, Any] = tab.evaluate("shown")
    return frame


def save(png: bytes, path: Path) -> None:
    """A picture of 256 colours: a third of the bytes."""
    picture = (
        Image.open(io.BytesIO(png))
        .convert("RGB")
        .quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1)
    )
    picture.save(path, optimize=True)
    print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
