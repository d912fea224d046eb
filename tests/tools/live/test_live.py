"""The live view of a fleet that flies in lock-step, in a real browser."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from chromium import chromium

pytest.importorskip("rclpy")

ROOT = Path(__file__).parents[3]
LIMIT_MS = 240_000  # the first flight compiles the laws

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def launched(*words: str) -> subprocess.Popen[str]:
    environment = {k: v for k, v in os.environ.items() if k != "ROS_DOMAIN_ID"}
    return subprocess.Popen(
        [sys.executable, "-m", "ptnsbc_tools", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        cwd=ROOT,
    )


def address_of(process: subprocess.Popen[str], lines: list[str]) -> str:
    assert process.stderr is not None
    for line in process.stderr:
        lines.append(line)
        if "live view: " in line:
            return line.split()[-1]
    raise AssertionError(f"no address: {lines}")


@pytest.fixture
def fleet() -> Iterator[tuple[subprocess.Popen[str], str, int]]:
    """A fleet that flies until it is ended, the address of its page, and its domain."""
    lines: list[str] = []
    words = ("fleet", "paper_5", "--lockstep", "--processes", "2", "--view", "--duration", "900")
    process = launched(*words)
    watchdog = threading.Timer(LIMIT_MS / 1000, process.kill)
    watchdog.start()
    try:
        address = address_of(process, lines)
        [domain] = [int(line.split()[1].strip(",")) for line in lines if line.startswith("domain ")]
        yield process, address, domain
    finally:
        watchdog.cancel()
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.communicate()


@pytest.fixture
def browser() -> Iterator[Any]:
    with chromium() as running:
        yield running


def opened(browser: Any, address: str, complaints: list[str]) -> Any:
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(LIMIT_MS)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(address)
    page.wait_for_selector("html[data-ready=true]")
    return page


def test_a_flying_fleet_is_shown_joined_ordered_and_found_again(browser: Any, fleet: Any) -> None:
    process, address, domain = fleet
    complaints: list[str] = []
    page = opened(browser, address, complaints)

    # It is fed: time passes, every UAV has numbers, the deadline is counted down and drawn.
    page.wait_for_function("() => page.clock.end > 1 && page.data.charts[0].curves[4].t.length > 5")
    page.wait_for_function(
        "() => document.querySelector('#countdown').textContent.includes('deadline')"
    )
    rows = page.locator("#board tr")
    assert rows.count() == 5
    page.wait_for_function(
        "() => [...document.querySelectorAll('#board tr')].every((row) => row.cells[1].textContent === 'form')"
    )
    errors = [float(text) for text in page.locator("#board tr td:nth-child(6)").all_inner_texts()]
    assert len(errors) == 5
    page.locator("#chart-errors .main-svg").first.wait_for()

    # The curves that are drawn grow with the flight.
    page.wait_for_function("() => page.figures.charts[0].drawn")
    page.evaluate("() => { window.drawn = () => page.figures.charts[0].plot.calcdata[0].length; }")
    before = page.evaluate("drawn()")
    page.wait_for_function("(before) => drawn() > before", arg=before)

    # Back in time, and live again.
    page.evaluate("page.clock.seek(0.5)")
    assert page.locator("#golive").get_attribute("aria-pressed") == "false"
    assert page.locator("#now").inner_text() == "0.50 s"
    page.locator("#golive").click()
    page.wait_for_function("() => page.clock.now === page.clock.end")

    # A page that loses its connection comes back, with the flight so far.
    page.evaluate("() => { window.before = page.clock.end; live.socket.close(); }")
    page.wait_for_selector("html[data-connected=false]")
    page.wait_for_selector("html[data-connected=true]")
    page.wait_for_function(
        "() => page.clock.end > before && page.data.charts[0].curves[0].t[0] < before"
    )

    # A second viewer joins the fleet that flies, and knows its scenario from a UAV.
    other = launched("view", "--domain", str(domain))
    try:
        joined = opened(browser, address_of(other, []), complaints)
        assert joined.locator("h1").inner_text() == "paper_5"
        joined.wait_for_function("() => page.data.charts[0].curves[4].t.length > 2")
    finally:
        other.send_signal(signal.SIGINT)
        other.communicate(timeout=60)
    assert other.returncode == 0
    joined.wait_for_selector("html[data-connected=false]")

    # An order needs a yes.
    page.locator("[data-order=hold]").click()
    page.locator("#confirm").get_by_role("button", name="Cancel").click()
    assert page.locator("#notice").inner_text() == ""
    page.locator("[data-order=land]").click()
    page.locator("#confirmed").click()
    page.wait_for_function("() => document.querySelector('#leg').textContent === 'land'")
    assert "the leader has announced it" in page.locator("#notice").inner_text()

    # The fleet ends in order. The page keeps what was drawn, and shows the verdict and the report.
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=LIMIT_MS / 1000)
    assert process.returncode == 130
    page.wait_for_selector("html[data-connected=false]")
    assert page.locator("#countdown").inner_text() in ("met", "met late", "missed", "void")
    assert page.locator("[data-order=stop]").is_disabled()
    assert page.locator("#chart-errors .main-svg").first.is_visible()
    with page.context.expect_page() as opened_page:  # from the page itself: the server is gone
        page.get_by_role("link", name="Open the report").click()
    opened_page.value.wait_for_selector("html[data-ready=true]")
    assert opened_page.value.locator("h1").inner_text() == "paper_5"
    assert complaints == []
