"""The process of a viewer: it looks at one fleet and feeds pages and a dashboard until it is told to end."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_nodes.runtime.signals import StopRequest
from ptnsbc_nodes.view.observer import Observer
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_tools import console
from ptnsbc_tools.library.reporting import report
from ptnsbc_tools.live.dashboard import OVER, Sink
from ptnsbc_tools.live.server import STOPS, Feed, LiveServer, live_page
from ptnsbc_tools.plotting.charts import COLOURS, DARK_COLOURS
from ptnsbc_tools.report.page import obstacles_of, uav_of

_PATH_POINTS = 400

FRAMES_HZ = 10
_JOIN_S = 30.0
_STOP_S = 30.0


def stage(scenario: Scenario) -> dict[str, Any]:
    """Name, UAVs, obstacles, the leader's path and the figure of errors; times [s], lengths [m]."""
    vector = leader_trajectory(scenario)
    times = np.linspace(0.0, float(scenario.timing.duration_s), _PATH_POINTS)
    path = np.array([reference(vector, float(t)).position for t in times])
    offsets = np.array([scenario.offset(uav) for uav in scenario.uav_ids])
    starts = np.array([scenario.uav(uav).position for uav in scenario.uav_ids])
    # around the starts and around the formation all along the path
    low = np.min([path.min(0) + offsets.min(0), starts.min(0)], axis=0)
    high = np.max([path.max(0) + offsets.max(0), starts.max(0)], axis=0)
    return {
        "name": scenario.name,
        "duration": float(scenario.timing.duration_s),
        "tolerance": float(scenario.formation.tolerance_m),
        "colours": {"light": COLOURS, "dark": DARK_COLOURS},
        "space": {
            "path": np.round(path, 4).ravel().tolist(),
            "bounds": [low.tolist(), high.tolist()],
            "uavs": [
                {**uav_of(scenario, uav), "avoiding": [], "deadlocks": []}
                for uav in scenario.uav_ids
            ],
            "obstacles": obstacles_of(scenario),
        },
        "starts": starts.tolist(),
    }


def watch(
    domain: int,
    namespace: str,
    scenario: Scenario | None,
    say: Callable[[str], None],
    sink_of: Callable[[Scenario], Sink] | None = None,
    *,
    port: int | None = 0,
    next_word: Callable[[], str | None] = lambda: None,
) -> None:
    """Look at a fleet until SIGINT or SIGTERM, on a page if it has a port.

    Without a `scenario` a UAV says what is flown; `sink_of` makes a further receiver of its frames. `next_word` of a
    launcher is OVER when the fleet has ended, and the last one ends the view: see `show_end`.
    """
    with StopRequest() as stop, ExitStack() as stack:
        observer = stack.enter_context(Observer(domain, namespace))
        with console.patience(f"looking for a fleet in domain {domain}"):
            scenario = scenario or observer.scenario(_JOIN_S, lambda: stop.came)
        state = observer.watch(scenario)
        feed = Feed()
        feed.set_stage(stage(scenario))
        server = None
        if port is not None:
            server = stack.enter_context(LiveServer(feed, live_page, port))
            say(f"live view: {server.address}")
        sinks = [feed.add, *([] if sink_of is None else [sink_of(scenario)])]
        shown, last = 0, None
        while not stop.came and last is None:
            observer.spin(1.0 / FRAMES_HZ)
            if state.flown_anew != shown:
                shown = state.flown_anew
                feed.set_stage(stage(state.scenario))
            frame = state.frame()
            for sink in sinks:
                sink(frame)
            while server is not None and not server.orders.empty():
                feed.tell("said", text=_obey(server.orders.get(), observer, domain, namespace))
            last = next_word()
            if last == OVER:
                state.processes.over, last = True, None
        if server is not None and last and last.strip():
            show_end(feed, json.loads(last), reported=server.looked_at)


def show_end(feed: Feed, last: dict[str, Any], *, reported: bool) -> None:
    """Show `verdict` and `line` of a flight that is over and, if `reported`, the report of `bag`; is it `kept`?"""
    feed.tell("end", verdict=last["verdict"], line=last["line"])
    if reported:
        page = report(last["bag"]).page
        path = str(page.resolve()) if last["kept"] else ""
        feed.tell("report", page=page.read_text("utf-8"), path=path)


def _obey(order: str, observer: Observer, domain: int, namespace: str) -> str:
    """Give an order to the fleet; what has become of it, in a line."""
    words = STOPS.get(order)
    if words is None:
        refusal = observer.call(order)
        return f"{order}: {refusal or 'the leader has announced it'}"
    command = [sys.executable, "-m", "ptnsbc_tools", *words, "--domain", str(domain)]
    command += ["--namespace", namespace] if namespace else []
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_STOP_S)
    except subprocess.TimeoutExpired:
        return f"{' '.join(words)}: no answer in {_STOP_S:g} s"
    return f"{' '.join(words)}: " + "; ".join(done.stderr.split("\n")).strip("; ")


def write_frame(frame: dict[str, Any]) -> None:
    """Write a frame as a line of JSON, for the dashboard of the launcher."""
    print(json.dumps(frame, allow_nan=False, separators=(",", ":")), flush=True)


def words_on_stdin() -> Callable[[], str | None]:
    """The next line on stdin, empty when stdin has ended; None before it is there."""
    words: queue.SimpleQueue[str] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            words.put(line)
        words.put("")

    threading.Thread(target=read, daemon=True).start()
    return lambda: None if words.empty() else words.get()
