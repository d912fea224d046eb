"""A viewer beside a flight of `ptnsbc fleet`: a process of its own, so that the launcher waits for nothing it does."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from ptnsbc_sim.scenario import Scenario
from ptnsbc_tools.live.dashboard import Dashboard

_END_S = 5.0
_ADDRESS = ("live view: ", "Foxglove: ")


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
    ) -> Callable[[Mapping[str, str], Path], ExitStack] | None:
        """The value for `FleetOptions.beside`; None when nothing is shown."""
        if not self.wanted:
            return None

        def run(settings: Mapping[str, str], scenario_file: Path) -> ExitStack:
            stack = ExitStack()
            stack.enter_context(_process(self, settings, scenario_file, say))
            return stack

        return run


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
    viewing: Viewing, settings: Mapping[str, str], scenario_file: Path, say: Callable[[str], None]
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
