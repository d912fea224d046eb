"""The page in a real browser, opened from the disk with the network away."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import chromium

from ptnsbc_sim.counters import COUNTERS
from ptnsbc_sim.verdict import Track
from ptnsbc_tools.library.flight import flight_in
from ptnsbc_tools.plotting.charts import view_of
from ptnsbc_tools.reading.bag_reader import StatusSeries, read_recording
from ptnsbc_tools.report.page import page

SAMPLE = Path(__file__).parents[3] / "bags" / "sample"

# Plotly's own pixels between two times, and how many curves of two figures are shown.
APART = """() => {
  const axis = document.querySelector('#chart-errors .plot')._fullLayout.xaxis;
  return axis.l2p(5) - axis.l2p(1);
}"""
SHOWN = """(() => ['#chart-errors', '#chart-between'].map((id) =>
  document.querySelector(id + ' .plot').data.filter((curve) => curve.visible).length).join())()"""
STICK_OUT = """() => [...document.querySelectorAll('.live, .view, .chart, .transport, .scroll')]
  .filter((one) => one.scrollWidth > one.clientWidth + 1).map((one) => one.className)"""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("report") / "index.html"
    file.write_text(page(flight_in(SAMPLE).view, {}), encoding="utf-8")
    return file.as_uri()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as running:
        yield running


class Tab:
    """An open page, and what it said and asked for."""

    def __init__(self, browser: Any, address: str, **options: Any) -> None:
        self.context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}} | options)
        self.context.set_offline(True)
        self.said: list[str] = []
        self.asked: list[str] = []
        self.page = self.context.new_page()
        self.page.on("console", self._on_console)
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(address)

    def _on_console(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.said.append(message.text)

    def ready(self) -> Any:
        self.page.wait_for_selector("html[data-ready=true]")
        return self.page

    def drawn(self) -> None:
        """Scroll past every figure, as a reader does, and wait until all are there."""
        for card in self.page.locator(".chart").all():
            card.scroll_into_view_if_needed()
            card.locator(".main-svg").first.wait_for()

    def place(self, uav: int) -> list[float]:
        """Where a UAV is in the picture [pixels], once the picture is that of the time shown."""
        self.page.wait_for_function(
            "() => page.scene.poses && page.scene.now === page.clock.now && !page.scene.due"
        )
        return self.page.evaluate(
            f"page.scene.camera.project(page.scene.poses[{uav - 1}]).slice(0, 2)"
        )


@pytest.fixture
def tab(browser: Any, address: str) -> Iterator[Any]:
    tabs = []

    def open_tab(where: str = address, **options: Any) -> Tab:
        tabs.append(Tab(browser, where, **options))
        return tabs[-1]

    yield open_tab
    for one in tabs:
        one.context.close()


@pytest.mark.slow
def test_the_slider_moves_time_and_uavs(tab: Any) -> None:
    one = tab()
    page = one.ready()
    before = one.place(1)
    page.locator("#time").focus()
    page.keyboard.press("ArrowRight")
    assert page.locator("#now").inner_text() == "0.10 s"
    page.locator("#time").fill("4")
    assert page.locator("#now").inner_text() == "4.00 s"
    after = one.place(1)
    assert max(abs(a - b) for a, b in zip(before, after, strict=True)) > 20
    picture = page.locator("#space").screenshot()
    page.keyboard.press("End")
    one.place(1)
    assert page.locator("#space").screenshot() != picture


@pytest.mark.slow
def test_play_and_pause(tab: Any) -> None:
    page = tab().ready()
    page.get_by_role("button", name="Play").click()
    page.wait_for_function("() => page.clock.now > 0.2")
    page.get_by_role("button", name="Pause").click()
    assert page.evaluate("page.clock.playing") is False
    page.locator("#speed").select_option("10")
    page.locator("h1").click()
    page.keyboard.press("Space")
    page.wait_for_function("() => !page.clock.playing && page.clock.now === page.clock.end")
    page.locator("#speed").select_option("0.1")
    page.locator("h1").click()
    page.keyboard.press("Space")  # at the end: again from the epoch
    assert page.evaluate("page.clock.playing && page.clock.now < page.clock.end")


@pytest.mark.slow
def test_the_line_in_the_figures_follows(tab: Any) -> None:
    one = tab()
    page = one.ready()
    cursor = page.locator("#chart-errors .cursor")
    page.locator("#chart-errors").scroll_into_view_if_needed()
    page.locator("#chart-errors .main-svg").first.wait_for()
    edges = []
    for time in (1, 5):
        page.evaluate(f"page.clock.seek({time})")
        cursor.wait_for()  # shown with the next frame
        edges.append(cursor.bounding_box()["x"])
    axis = page.evaluate(APART)
    assert edges[1] - edges[0] == pytest.approx(axis, abs=2)
    # Zoomed to a span without the time, it is not there.
    page.evaluate(
        "Plotly.relayout(document.querySelector('#chart-errors .plot'), {'xaxis.range': [6, 7]})"
    )
    page.wait_for_function("() => document.querySelector('#chart-errors .cursor').hidden")


@pytest.mark.slow
def test_a_uav_is_hidden_everywhere(tab: Any) -> None:
    one = tab()
    page = one.ready()
    one.drawn()
    assert page.evaluate(SHOWN) == "5,5"
    page.get_by_role("button", name="3", exact=True).click()
    page.wait_for_function(f"() => {SHOWN} === '4,4'")
    for pair in ("1,1", "5,5"):  # alone, and everybody again
        page.get_by_role("button", name="3", exact=True).click(modifiers=["Shift"])
        page.wait_for_function(f"() => {SHOWN} === '{pair}'")
    assert one.said == []


@pytest.mark.slow
def test_the_view_turns_with_the_mouse(tab: Any) -> None:
    one = tab()
    page = one.ready()
    before = one.place(5)
    box = page.locator("#space").bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 420, box["y"] + 230, steps=3)
    page.mouse.up()
    assert one.place(5) != before
    page.get_by_role("button", name="Reset", exact=True).click()
    assert one.place(5) == pytest.approx(before, abs=0.5)


@pytest.mark.slow
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (800, "dark"), (390, "light")])
def test_offline_without_a_request_a_complaint_or_an_overflow(
    tab: Any, address: str, width: int, scheme: str
) -> None:
    one = tab(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page = one.ready()
    one.drawn()
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate("document.documentElement.dataset.theme") == scheme
    swiped = set() if width >= 800 else {"scroll"}  # tables on a phone
    assert set(page.evaluate(STICK_OUT)) == swiped
    assert one.asked == [address]
    assert one.said == []


@pytest.mark.slow
def test_an_address_may_name_the_time(tab: Any, address: str) -> None:
    page = tab(f"{address}#t=4.25").ready()
    assert page.locator("#now").inner_text() == "4.25 s"
    assert page.locator("#events .mark").all_inner_texts() == ["deadline 5 s"]


@pytest.mark.slow
def test_playback_comes_before_tables_and_figures(tab: Any) -> None:
    page = tab().ready()
    tops = [
        page.locator(what).first.bounding_box()["y"]
        for what in (".verdict", "#stage", ".scroll", "#charts")
    ]
    assert tops == sorted(tops)


@pytest.mark.slow
def test_what_is_printed_is_complete(tab: Any) -> None:
    """All figures without a scroll, every legend, details open, and nothing cut off at the width of paper."""
    one = tab()
    page = one.ready()
    page.wait_for_function("() => page.figures.charts.every((one) => one.drawn)")
    legends = page.locator(".chart .legend .traces").count()
    curves = page.evaluate(
        "page.data.charts.map((one) => one.curves.length).filter((n) => n > 1).reduce((a, b) => a + b)"
    )
    assert legends == curves
    page.emulate_media(media="print")
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    assert page.locator("details:not([open])").count() == 0
    assert not page.locator("#transport").is_visible()
    page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    assert page.locator("details[open]").count() == 0
    assert page.pdf(format="A4").startswith(b"%PDF")
    assert one.said == []


@pytest.mark.slow
def test_another_flight_is_overlaid(tab: Any, tmp_path: Path) -> None:
    shown, other = (flight_in(SAMPLE).view for _ in range(2))
    file = tmp_path / "index.html"
    file.write_text(page(shown, {}, other), encoding="utf-8")
    opened = tab(file.as_uri()).ready()
    labels = opened.evaluate(
        "page.data.charts.find((one) => one.key === 'errors').curves.map((one) => [one.label, one.colour, one.dash])"
    )
    assert len(labels) == 10
    for own, beside in zip(labels[:5], labels[5:], strict=True):
        assert beside[0] == f"{own[0]}, flight sample" and beside[1] == own[1]
        assert beside[2] != own[2]
    card = opened.locator("#chart-errors")
    card.scroll_into_view_if_needed()
    card.locator(".main-svg").first.wait_for()
    assert card.locator(".legend .traces").count() == 5  # the note says what the dots are
    assert "Dotted, in the same colours: flight sample." in card.locator(".note").inner_text()


def test_names_cover_no_other_name(tab: Any) -> None:
    """Five UAVs seen as one spot from afar."""
    one = tab()
    opened = one.ready()
    opened.evaluate("page.scene.camera.zoom(6)")
    opened.evaluate("page.scene.paint()")
    boxes = opened.evaluate(
        "page.scene.names.map(({place: {x, y, half}}) => [x - half, y - NAME_HALF, x + half, y + NAME_HALF])"
    )
    for (x0, y0, x1, y1), (u0, v0, u1, v1) in combinations(boxes, 2):
        assert x1 <= u0 or u1 <= x0 or y1 <= v0 or v1 <= y0
    assert len(boxes) == 5 + opened.evaluate("page.data.space.obstacles.length")


LABELS = """() => {
  const { scene } = page;
  const [wide, high] = scene.camera.middle.map((half) => 2 * half);
  const reach = ([x, y]) => {
    scene.names = [];
    scene.label("O1", x, y, 100);
    const half = scene.pen.measureText("O1").width / 2;
    return scene.names.map(({ x: at }) => at - half >= 0 && at + half <= wide);
  };
  return [[-50, high / 2], [wide + 50, high / 2], [wide / 2, high / 2], [wide + 200, high / 2]].map(reach);
}"""


def test_the_name_of_an_obstacle_at_the_edge_is_whole(tab: Any) -> None:
    one = tab()
    page = one.ready()
    one.place(1)
    assert page.evaluate(LABELS) == [[True], [True], [True], []]  # the last one is out of sight


@pytest.mark.slow
def test_a_deadlock_stands_in_the_bar_of_time(tab: Any, tmp_path: Path) -> None:
    view = flight_in(SAMPLE).view
    track = view.recording.counters[3]
    values = track.rows(0, track.size).values.copy()
    values[:, COUNTERS.index("deadlock_s")] = np.clip(np.arange(len(values)) - 10.0, 0.0, 5.0)
    stuck = {**view.recording.counters, 3: Track(track.rows(0, track.size).t_ns, values)}
    file = tmp_path / "index.html"
    shown = view_of(replace(view.recording, counters=stuck), StatusSeries())
    file.write_text(page(shown, {}), encoding="utf-8")
    opened = tab(file.as_uri()).ready()
    assert opened.locator("#events .stuck").count() == 1
    assert "UAV 3: deadlock" in opened.locator("#events .mark").all_inner_texts()
    opened.evaluate("page.clock.seek(page.data.space.uavs[2].deadlocks[0][0] + 0.1)")
    opened.wait_for_selector("#live tr.stuck")
    assert opened.locator("#live tr.stuck button").inner_text() == "3"


def test_shaded_areas_have_a_legend(tab: Any) -> None:
    opened = tab().ready()
    note = opened.locator("#chart-errors .note")
    assert note.locator(".swatch.band").count() == 1
    assert "widest band" in note.inner_text()


def test_without_script_the_verdict_is_there(tab: Any) -> None:
    page = tab(java_script_enabled=False).page
    assert page.locator(".badge").inner_text().lower() == "met"
    assert page.locator("caption", has_text="Deadline").is_visible()
    assert page.locator("noscript").is_visible()


def test_a_flight_without_odometry_has_a_page_too(tab: Any, tmp_path: Path) -> None:
    recording = replace(read_recording(SAMPLE), odometry={}, wrench={}, counters={})
    file = tmp_path / "index.html"
    file.write_text(page(view_of(recording, StatusSeries()), {}), encoding="utf-8")
    one = tab(file.as_uri())
    opened = one.ready()
    assert opened.locator(".line").inner_text().startswith("No verdict: no message on /uav1/odom")
    assert not opened.locator("#transport").is_visible()
    assert one.said == []
