"""A flight in the terminal, and the viewer beside `ptnsbc fleet`: a process for which the launcher never waits."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools import console

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

    from ptnsbc_tools.live.watch import Sink

_WIDE = 110  # columns from which on everything is shown
_REFRESH_HZ = 4
_MOST_FAULTS = 5
_NAME = 5  # letters of the nearest thing
_BAR = 12
_BAR_DECADES = 4.0  # a full bar is so many times the tolerance, in powers of ten

_END_S = 5.0
_ADDRESS = ("live view: ", "Foxglove: ")


class Dashboard:
    """Redraws itself at the bottom of the terminal; use it as a context manager."""

    def __init__(self) -> None:
        from rich.live import Live

        self._lock = threading.Lock()
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._live.stop()

    def say(self, line: str) -> None:
        """A line above the table; the pace of the sim is in the table already."""
        if not (line.startswith("sim: ") and line.endswith(" steps/s")):
            self._live.console.print(console.plain(line), highlight=False)

    def sink(self, scenario: Scenario) -> Sink:
        """The receiver of the frames of this flight."""
        self._scenario = scenario

        def show(frame: dict[str, Any]) -> None:
            with self._lock:
                self._frame = frame

        return show

    def _render(self) -> RenderableType:
        with self._lock:
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
    table = _board(frame, scenario) if frame["leg"] == "waiting" else _table(frame, scenario, width)
    inside = Group(table, *lines)
    return Panel(inside, title=_title(frame, scenario), width=width, padding=(0, 1))


def _title(frame: dict[str, Any], scenario: Scenario) -> str:
    parts = [scenario.name, frame["leg"]]
    if frame["t"] is not None:
        parts.append(f"{frame['t']:.1f} of {scenario.timing.duration_s:g} s")
    if frame["left_s"] is not None:
        left = frame["left_s"]
        parts.append(f"deadline in {left:.1f} s" if left > 0 else f"deadline {-left:.1f} s ago")
    if frame["pace"] is not None:
        parts.append(f"{frame['pace']:.2f}x")
    if frame["over"]:
        parts.append("over")
    return " | ".join(parts)


def _board(frame: dict[str, Any], scenario: Scenario) -> RenderableType:
    """The health board before the flight: what each UAV waits for, its fix, its mode and its battery."""
    table = _empty_table()
    table.add_column("UAV", no_wrap=True)
    table.add_column("step, or what it waits for", overflow="fold", ratio=1)
    for name in ("GNSS fix", "mode"):
        table.add_column(name, no_wrap=True)
    for name in ("bat %", "height m"):
        table.add_column(name, justify="right", no_wrap=True)
    for uav in frame["uavs"]:
        words = (
            _name(uav, scenario),
            uav["readiness"] or "not heard",
            uav["fix"] or "-",
            _mode(uav),
        )
        numbers = _number(uav["battery"], 0), _number(uav["pose"] and uav["pose"][2], 2)
        style = "red" if uav["lost"] or uav["readiness"] is None else ""
        table.add_row(*words, *numbers, style=style)
    return table


def _empty_table() -> Table:
    from rich import box
    from rich.table import Table

    return Table(box=box.SIMPLE_HEAD, expand=True, pad_edge=False, padding=(0, 1))


def _name(uav: dict[str, Any], scenario: Scenario) -> str:
    return f"{uav['id']} leader" if uav["id"] == scenario.leader.id else str(uav["id"])


def _table(frame: dict[str, Any], scenario: Scenario, width: int) -> RenderableType:
    table = _empty_table()
    table.add_column("UAV", no_wrap=True)
    names = ["error m", "height m", "speed m/s", "nearest m"]
    wide = width >= _WIDE
    if wide:
        table.add_column("error, log scale", no_wrap=True)
    for name, least in zip(names, (9, 8, 9, 9 + _NAME), strict=True):
        table.add_column(name, justify="right", no_wrap=True, min_width=least)
    table.add_column("mode", no_wrap=True, overflow="ellipsis")
    battery = any(uav["battery"] is not None for uav in frame["uavs"])
    if battery:
        table.add_column("bat %", justify="right", no_wrap=True)
    if wide:
        table.add_column("east, north, up m", justify="right", no_wrap=True)
    tolerance = scenario.formation.tolerance_m
    for uav in frame["uavs"]:
        cells = [_name(uav, scenario)]
        if wide:
            cells.append(_bar(uav["error"], tolerance))
        near = uav["near"]
        cells += [
            _number(uav["error"], 4),
            _number(uav["pose"] and uav["pose"][2], 2),
            _number(uav["speed"], 2),
            f"{near['distance']:.2f} {near['name'].replace('UAV ', 'uav'):.{_NAME}}"
            if near
            else "-",
            _mode(uav),
        ]
        if battery:
            cells.append(_number(uav["battery"], 0))
        if wide:
            cells.append(" ".join(f"{one:7.2f}" for one in uav["pose"][:3]) if uav["pose"] else "-")
        table.add_row(*cells, style=_style(uav, tolerance))
    return table


def _style(uav: dict[str, Any], tolerance: float) -> str:
    if uav["lost"] or (uav["near"] and uav["near"]["room"] < 0):
        return "red"
    return "green" if uav["error"] is not None and uav["error"] <= tolerance else ""


def _mode(uav: dict[str, Any]) -> str:
    if uav["lost"]:
        return "lost"
    parts = [uav["mode"], uav["vehicle"], "armed" if uav["armed"] else None]
    return " ".join(part for part in parts if part) or "-"


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _bar(error: float | None, tolerance: float) -> str:
    """Empty at a hundredth of the tolerance, full at a hundred times; the mark is the tolerance."""
    from math import log10

    if error is None:
        return ""
    decades = log10(max(error, 1e-9) / tolerance) + _BAR_DECADES / 2
    filled = round(_BAR * min(max(decades / _BAR_DECADES, 0.0), 1.0))
    middle = _BAR // 2
    bar = "#" * filled + "." * (_BAR - filled)
    return f"{bar[:middle]}|{bar[middle:]}"


@dataclass(frozen=True)
class Viewing:
    """The views of a flight while it is flown."""

    scenario: Scenario
    namespace: str = ""
    page: bool = False
    foxglove: int | None = None
    dashboard: Dashboard | None = None

    @property
    def wanted(self) -> bool:
        """True if anything is shown."""
        return self.page or self.foxglove is not None or self.dashboard is not None

    def beside(
        self, say: Callable[[str], None]
    ) -> Callable[[Mapping[str, str], Path], AbstractContextManager[None]] | None:
        """The value for `FleetOptions.beside`; None when nothing is shown."""
        return partial(_process, self, say) if self.wanted else None


def _command(viewing: Viewing, domain: str, scenario_file: Path) -> list[str]:
    command = [sys.executable, "-m", "ptnsbc_tools", "view", str(scenario_file), "--plain"]
    command += ["--domain", domain]
    if viewing.namespace:
        command += ["--namespace", viewing.namespace]
    if not viewing.page:
        command.append("--no-page")
    if viewing.foxglove is not None:
        command += ["--foxglove", str(viewing.foxglove)]
    if viewing.dashboard is not None:
        command.append("--frames")
    return command


@contextmanager
def _process(
    viewing: Viewing, say: Callable[[str], None], settings: Mapping[str, str], scenario_file: Path
) -> Iterator[None]:
    process = subprocess.Popen(
        _command(viewing, settings["ROS_DOMAIN_ID"], scenario_file),
        env=dict(settings),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C is for the launcher
    )
    log = scenario_file.with_name("view.log")
    readers = [
        threading.Thread(target=_pass_frames, args=(process.stdout, viewing), daemon=True),
        threading.Thread(target=_pass_lines, args=(process.stderr, log, say), daemon=True),
    ]
    for reader in readers:
        reader.start()
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for reader in readers:
            reader.join()


def _pass_frames(lines: Iterable[str], viewing: Viewing) -> None:
    show = None if viewing.dashboard is None else viewing.dashboard.sink(viewing.scenario)
    for line in lines:
        if show is not None:
            show(json.loads(line))


def _pass_lines(lines: Iterable[str], log: Path, say: Callable[[str], None]) -> None:
    """All lines into the log of the viewer; those for people to the terminal as well."""
    with log.open("w") as file:
        for line in lines:
            file.write(line)
            file.flush()
            if line.startswith(_ADDRESS) or "error: " in line:
                say(line.rstrip())
