"""A flight in the terminal, and the viewer beside `ptnsbc fleet`: a process for which the launcher never waits."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools import console

if TYPE_CHECKING:
    from rich.console import RenderableType


_REFRESH_HZ = 4
_MOST_FAULTS = 5
_NAME = 5  # letters of the nearest thing
_WAITS = "step, or what it waits for"
_LEAST = {"error m": 9, "height m": 8, "speed m/s": 9, "nearest m": 9 + _NAME}  # widths

_END_S = 30.0  # for the report of a page that is open
Sink = Callable[[dict[str, Any]], None]
"""Takes every frame (`FlightState.frame`)."""
OVER = "over\n"
"""Told to the viewer when the fleet has ended."""
_ADDRESS = "live view: "


class Dashboard:
    """Redraws itself at the bottom of the terminal; use it as a context manager."""

    def __init__(self) -> None:
        from rich.live import Live

        self._frame: dict[str, Any] | None = None
        self._scenario: Scenario | None = None
        self._live = Live(
            console=console.err(),
            get_renderable=self._render,
            refresh_per_second=_REFRESH_HZ,
            vertical_overflow="visible",
        )

    def __enter__(self) -> Dashboard:
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def say(self, line: str) -> None:
        """A line above the table; the pace of the sim is in the table already."""
        if not (line.startswith("sim: ") and line.endswith(" steps/s")):
            self._live.console.print(console.plain(line), highlight=False)

    def sink(self, scenario: Scenario) -> Sink:
        """The receiver of the frames of this flight."""
        self._scenario = scenario

        def show(frame: dict[str, Any]) -> None:
            self._frame = frame

        return show

    def _render(self) -> RenderableType:
        frame, scenario = self._frame, self._scenario
        if frame is None or scenario is None:
            return ""
        return picture(frame, scenario, self._live.console.width)


def picture(frame: dict[str, Any], scenario: Scenario, width: int) -> RenderableType:
    """The frame of `FlightState` as a table of at most `width` columns."""
    from rich.console import Group
    from rich.panel import Panel
    from rich.text import Text

    faults = [one for one in frame["processes"] if one["level"] > 0]
    lines = [
        Text(f"{one['name']}: {one['word']}", "red" if one["level"] > 1 else "yellow")
        for one in faults[:_MOST_FAULTS]
    ]
    if len(faults) > _MOST_FAULTS:
        lines.append(Text(f"and {len(faults) - _MOST_FAULTS} more", "yellow"))
    for line in lines:
        line.truncate(width - 4, overflow="ellipsis")
    inside = Group(_table(frame, scenario), *lines)
    return Panel(inside, title=_title(frame, scenario), width=width, padding=(0, 1))


def _title(frame: dict[str, Any], scenario: Scenario) -> str:
    parts = [scenario.name, frame["leg"]]
    if frame["t"] is not None:
        parts.append(f"{frame['t']:.1f} of {scenario.timing.duration_s:g} s")
    if frame["landing"]:
        parts.append(frame["landing"])
    if frame["left_s"] is not None:
        left = frame["left_s"]
        parts.append(f"deadline in {left:.1f} s" if left > 0 else f"deadline {-left:.1f} s ago")
    if frame["pace"] is not None:
        parts.append(f"{frame['pace']:.2f}x")
    if frame["over"]:
        parts.append("over")
    return " | ".join(parts)


def _table(frame: dict[str, Any], scenario: Scenario) -> RenderableType:
    """A row for each UAV; before the flight a health board: what each waits for, its fix, mode and battery."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, expand=True, pad_edge=False, padding=(0, 1))
    waiting = frame["leg"] == "waiting"
    with_battery = waiting or any(uav["battery"] is not None for uav in frame["uavs"])
    for uav in frame["uavs"]:
        height = _number(uav["pose"] and uav["pose"][2], 2)
        battery = {"bat %": _number(uav["battery"], 0)} if with_battery else {}
        leads = "leader" if uav["id"] == scenario.leader.id else ""
        name = " ".join(filter(None, (str(uav["id"]), leads, uav["label"])))
        if waiting:
            cells = {_WAITS: uav["readiness"] or "not heard", "GNSS fix": uav["fix"] or "-"}
            cells |= {"mode": _mode(uav), **battery, "height m": height}
            bad, good = uav["lost"] or uav["readiness"] is None, False
        else:
            near, tolerance = uav["near"], scenario.formation.tolerance_m
            nearest = near and near["name"].replace("UAV ", "uav")[:_NAME]
            cells = {"error m": _number(uav["error"], 4), "height m": height}
            cells["speed m/s"] = _number(uav["speed"], 2)
            cells["nearest m"] = f"{near['distance']:.2f} {nearest}" if near else "-"
            cells |= {"mode": _mode(uav), **battery}
            bad = not frame["landing"] and (uav["lost"] or (near and near["room"] < 0))
            good = uav["error"] is not None and uav["error"] <= tolerance
        if not table.columns:
            table.add_column("UAV", no_wrap=True)
            for head in cells:
                if head == _WAITS:
                    table.add_column(head, overflow="fold", ratio=1)
                else:
                    side: Any = "right" if head.endswith(("m", "m/s", "%")) else "left"
                    least = _LEAST.get(head)
                    table.add_column(head, justify=side, no_wrap=True, min_width=least)
        table.add_row(name, *cells.values(), style="red" if bad else "green" if good else "")
    return table


def _mode(uav: dict[str, Any]) -> str:
    if uav["lost"]:
        return "lost"
    parts = [uav["mode"], uav["vehicle"], "armed" if uav["armed"] else None]
    return " ".join(part for part in parts if part) or "-"


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


class Viewer:
    """The process of `ptnsbc view` beside a flight; it ends with the verdict on its page."""

    def __init__(
        self, arguments: Sequence[str] | None, scenario: Scenario, dashboard: Dashboard | None
    ) -> None:
        """`arguments` of the command; None: nothing begins."""
        self.dashboard = dashboard
        self.say = console.say if dashboard is None else dashboard.say
        self._arguments, self._scenario = arguments, scenario
        self._process: subprocess.Popen[str] | None = None

    @contextmanager
    def beside(self, settings: Mapping[str, str], scenario_file: Path) -> Iterator[None]:
        """Begin (`FleetOptions.beside`); after the flight it goes on until `end`."""
        if self._arguments is None:
            yield
            return
        command = [sys.executable, "-m", "ptnsbc_tools", "view", str(scenario_file), "--plain"]
        command += ["--domain", settings["ROS_DOMAIN_ID"], *self._arguments, "--launched"]
        self._process = process = subprocess.Popen(
            command,
            env=dict(settings),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C is for the launcher
        )

        def pass_frames() -> None:
            show = None if self.dashboard is None else self.dashboard.sink(self._scenario)
            for line in process.stdout or ():
                if show is not None:
                    show(json.loads(line))

        def pass_lines() -> None:
            """All lines into the log of the viewer; those for people to the terminal as well."""
            with scenario_file.with_name("view.log").open("w") as file:
                for line in process.stderr or ():
                    file.write(line)
                    file.flush()
                    if line.startswith(_ADDRESS) or "error: " in line:
                        self.say(line.rstrip())

        for read in (pass_frames, pass_lines):
            threading.Thread(target=read, daemon=True).start()
        try:
            yield
        finally:
            self._tell(OVER)

    def _tell(self, line: str) -> None:
        with suppress(OSError):  # it may have ended by itself
            if self._process is not None and self._process.stdin is not None:
                self._process.stdin.write(line)
                self._process.stdin.flush()

    def end(self, last: Mapping[str, Any] | None = None) -> None:
        """Give it the last word, see `watch.show_end`, and wait until it has ended."""
        self._tell("\n" if last is None else json.dumps(last) + "\n")
        if self._process is not None:
            try:
                self._process.wait(_END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
