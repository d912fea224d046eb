"""Running the blocks of one page: real processes, real exit codes, all ended with the page."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Condition, Event
from typing import NamedTuple

from docs.commands.blocks import Block, How

_INTERRUPTED = 130
_LONGEST_S = 240.0
_ENDING_S = 60.0
_LOOK_S = 0.05
_TAIL_LINES = 25
_VEHICLES = "ptnsbc autopilot"


class Outcome(NamedTuple):
    """The outcome of a block."""

    block: Block
    took_s: float
    skipped: str = ""  # why
    problem: str = ""  # empty when all went well
    output: str = ""  # its end, where there is a problem


class InterruptedRunError(Exception):
    """The run of all pages is over before this page is."""


class Shared:
    """The machine, which pages share until one has it alone, and the end of the run."""

    def __init__(self) -> None:
        self.over = Event()
        """Set when no page shall go on."""
        self._changed = Condition()
        self._alone = False
        self._sharing = 0

    @contextmanager
    def beside_others(self) -> Iterator[None]:
        """Run while no page has the machine alone, or waits for that."""
        with self._changed:
            self._wait_until(lambda: not self._alone)
            self._sharing += 1
        try:
            yield
        finally:
            with self._changed:
                self._sharing -= 1
                self._changed.notify_all()

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Run when everybody else has ended: a flight in real time, with the UDP ports of the vehicles."""
        with self._changed:
            self._wait_until(lambda: not self._alone)
            self._alone = True
        try:
            with self._changed:
                self._wait_until(lambda: not self._sharing)
            yield
        finally:
            with self._changed:
                self._alone = False
                self._changed.notify_all()

    def _wait_until(self, free: Callable[[], bool]) -> None:
        while not self._changed.wait_for(free, _LOOK_S):
            if self.over.is_set():
                raise InterruptedRunError


class _Process:
    """A shell with the commands of a block, in a process group of its own."""

    def __init__(
        self, script: str, folder: Path, environment: Mapping[str, str], log: Path, over: Event
    ) -> None:
        self._log = log
        self._over = over
        with log.open("wb") as output:
            self._shell = subprocess.Popen(
                ["bash", "-euo", "pipefail", "-c", script],
                cwd=folder,
                env=dict(environment),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    @property
    def output(self) -> str:
        return self._log.read_text(encoding="utf-8", errors="replace")

    @property
    def code(self) -> int | None:
        """None while it runs; a shell that Ctrl-C ended counts as interrupted."""
        code = self._shell.poll()
        return _INTERRUPTED if code == -signal.SIGINT else code

    def wait(self, seconds: float, text: str | None = None) -> bool:
        """Until it has ended, or said `text`; False when it took longer."""
        end = time.monotonic() + seconds
        while self.code is None and (text is None or text not in self.output):
            if time.monotonic() > end:
                return False
            if self._over.wait(_LOOK_S):  # what stands in a log wakes nobody
                raise InterruptedRunError
        return True

    def interrupt(self) -> bool:
        """Ctrl-C, as a terminal sends it; False when it has to be killed."""
        self._signal(signal.SIGINT)
        if self.wait(_ENDING_S):
            return True
        self.kill()
        return False

    def kill(self) -> None:
        """Whatever is left of it."""
        self._signal(signal.SIGKILL)
        self._shell.wait()

    def _signal(self, number: signal.Signals) -> None:
        try:
            os.killpg(self._shell.pid, number)
        except ProcessLookupError:
            return


class Page:
    """The blocks of a page run in order, in one folder; use it as a context manager."""

    def __init__(
        self, folder: Path, logs: Path, environment: Mapping[str, str], ci: str, shared: Shared
    ) -> None:
        self._shared = shared
        self._folder = folder
        self._logs = logs
        self._environment = environment
        self._ci = {line.strip() for line in _commands_of(ci)}
        self._has_machine = False  # until the page is over
        self._beside: list[tuple[Block, _Process, float]] = []
        self._stack = ExitStack()

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def run(self, block: Block) -> Outcome:
        """One block, by its marker."""
        marker = block.marker
        if marker.how is How.SKIP:
            return Outcome(block, 0.0, skipped=marker.text)
        if marker.how is How.ELSEWHERE:
            return self._elsewhere(block)
        with ExitStack() as stack:
            if not self._has_machine:
                flies = _VEHICLES in block.script
                self._has_machine = flies or marker.how is How.BESIDE
                until = self._stack if self._has_machine else stack
                until.enter_context(self._shared.alone() if flies else self._shared.beside_others())
            return self._start_beside(block) if marker.how is How.BESIDE else self._run(block)

    def _run(self, block: Block) -> Outcome:
        began = time.monotonic()
        scripts = block.lines if block.marker.how is How.EACH else [_script(block)]
        for script in scripts:
            problem, output = self._one(script, block)
            if problem:
                return Outcome(block, time.monotonic() - began, "", problem, output)
        return Outcome(block, time.monotonic() - began)

    def finish(self) -> Iterator[Outcome]:
        """The results of the blocks in the background, last first, after Ctrl-C to those that run."""
        for block, process, began in reversed(self._beside):
            ended = process.code is not None
            own = block.marker.code
            allowed = (own,) if ended else (0, own, _INTERRUPTED)
            quick = ended or process.interrupt()
            problem = _verdict(process.code, allowed) if quick else "did not end at Ctrl-C"
            took = time.monotonic() - began
            yield Outcome(block, took, "", problem, _tail(process) if problem else "")
        self._beside.clear()

    def _elsewhere(self, block: Block) -> Outcome:
        missing = [line for line in block.lines if line not in self._ci]
        problem = f".ci/run has no command {', '.join(missing)}" if missing else ""
        return Outcome(block, 0.0, "" if missing else "runs in .ci/run", problem)

    def _start_beside(self, block: Block) -> Outcome:
        began = time.monotonic()
        process = self._stack.enter_context(self._process(_script(block)))
        said = process.wait(_LONGEST_S, block.marker.text) and block.marker.text in process.output
        if not said:
            problem = f"did not say {block.marker.text!r}, {_verdict(process.code, (0,))}"
            return Outcome(block, time.monotonic() - began, "", problem, _tail(process))
        self._beside.append((block, process, began))
        return Outcome(block, time.monotonic() - began)

    def _one(self, script: str, block: Block) -> tuple[str, str]:
        timed = block.marker.how in (How.FOR, How.EACH)
        with self._process(script) as process:
            if not timed:
                ended = process.wait(_LONGEST_S)
                allowed: tuple[int, ...] = (block.marker.code,)
                problem = _verdict(process.code, allowed) if ended else f"ran for {_LONGEST_S:g} s"
            elif process.wait(block.marker.seconds):
                problem = f"ended before {block.marker.seconds:g} s were over, {process.code}"
            elif process.interrupt():
                problem = _verdict(process.code, (0, _INTERRUPTED))
            else:
                problem = "did not end at Ctrl-C"
            return problem, _tail(process) if problem else ""

    @contextmanager
    def _process(self, script: str) -> Iterator[_Process]:
        log = self._logs / f"{len(list(self._logs.iterdir()))}.log"
        process = _Process(script, self._folder, self._environment, log, self._shared.over)
        try:
            yield process
        finally:
            process.kill()


def _commands_of(script: str) -> Iterator[str]:
    """The commands of `.ci/run`: what its steps call, and what its functions do."""
    for line in script.splitlines():
        bare = line.partition("#")[0].strip()
        step = re.fullmatch(r'step "[^"]*" (.+)', bare)
        body = re.fullmatch(r"\w+\(\) \{ (.+); \}", bare)
        yield (step or body)[1] if step or body else bare


def _script(block: Block) -> str:
    """The block with the words that its marker adds."""
    words = block.marker.words
    return f"{block.lines[0]} {words}" if words else block.script


def _verdict(code: int | None, allowed: tuple[int, ...]) -> str:
    expected = " or ".join(str(one) for one in allowed)
    return "" if code in allowed else f"exit code {code}: expected {expected}"


def _tail(process: _Process) -> str:
    return "\n".join(process.output.splitlines()[-_TAIL_LINES:])
