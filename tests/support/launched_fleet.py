"""A fleet of real processes, started for a test."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).parents[2]
PATIENCE_S = 240  # the first flight compiles the laws


class Launched:
    """`fleet_main` as a process of its own, with the lines it has said."""

    def __init__(self, log_dir: Path, *arguments: str, domain: int | None = None) -> None:
        """`arguments` of the launcher; without a `domain` it takes a free one."""
        self.log_dir = log_dir
        self.lines: list[str] = []
        environment = {k: v for k, v in os.environ.items() if k != "ROS_DOMAIN_ID"}
        if domain is not None:
            environment["ROS_DOMAIN_ID"] = str(domain)
        command = [sys.executable, "-m", "tests.support.fleet_main", "--scenario", "paper_5"]
        self.process = subprocess.Popen(
            [*command, "--lockstep", "--log-dir", str(log_dir), *arguments],
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
            cwd=ROOT,
        )
        # A fleet that hangs fails its test, instead of hanging that too.
        self._watchdog = threading.Timer(PATIENCE_S, self.process.kill)
        self._watchdog.daemon = True
        self._watchdog.start()

    def wait_for(self, *texts: str) -> None:
        """Return after the next line that has all of this."""
        for line in self.process.stderr:
            self.lines.append(line.rstrip())
            if all(text in line for text in texts):
                return
        raise AssertionError(f"never said {texts}: {self.lines}")

    def wait_until_flown(self, flight_s: float) -> None:
        """Return once the sim has told of as much flight."""
        while True:
            self.wait_for("sim: ", "steps/s")
            if float(self.lines[-1].partition("sim: ")[2].split()[0]) >= flight_s:
                return

    def finish(self) -> int:
        out, err = self.process.communicate()
        self._watchdog.cancel()
        assert out == ""
        self.lines += err.splitlines()
        return self.process.returncode

    def running(self) -> dict[int, str]:
        """Processes of this fleet besides the launcher: all of them name its scenario file."""
        found = {}
        for entry in Path("/proc").iterdir():
            if entry.name.isdecimal() and int(entry.name) != self.process.pid:
                try:
                    words = (entry / "cmdline").read_bytes().decode().split("\0")
                except OSError:
                    continue
                if any(str(self.log_dir / "scenario.yaml") in word for word in words):
                    found[int(entry.name)] = " ".join(words)
        return found

    def pid_of(self, words: str) -> int:
        (pid,) = [pid for pid, command in self.running().items() if words in command]
        return pid

    def all_end(self, within_s: float) -> bool:
        deadline = time.monotonic() + within_s
        for pid in self.running():
            with suppress(ProcessLookupError):
                end = os.pidfd_open(pid)
                select.select([end], [], [], max(deadline - time.monotonic(), 0.0))
                os.close(end)
        return not self.running()
