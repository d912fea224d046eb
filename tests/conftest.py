"""What several workers share: the files to collect, the laws to compile, and the order of the tests."""

from __future__ import annotations

import fcntl
import gc
import json
import os
import signal
import sys
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers

sys.path.insert(0, str(Path(__file__).parent / "support"))

import real_time

from ptnsbc_nodes.emergency import forget_dead, release

HERE = Path(__file__).parent
# Folders and files below tests/ that run without a whole control step.
WITHOUT_LAWS = (
    "docs/test_commands",
    "docs/test_words",
    "io/",
    "nodes/recording/",
    "sim/scenario/",
    "test_",
)
COMPILES, LAWS, WITHOUT, LONG, SHORT = range(5)

COUNTED = ("passed", "failed", "skipped", real_time.NOT_JUDGED)

# Neither a slow machine nor chance decides.
settings.register_profile(
    "steady",
    max_examples=40,  # `make fuzz` tries more
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("steady")

# Hypothesis draws constants of all modules that are imported by then: the order of the tests would decide.
providers._get_local_constants = lambda: providers._local_constants

# As for `make test &`: whatever the tests start would ignore it too, and be waited for.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _each_law_is_compiled_once() -> None:
    """Workers that need the same law at the same time: one compiles it, the others wait and read it."""
    try:
        from numba.core.dispatcher import Dispatcher
    except ImportError:
        return
    file = Path(tempfile.gettempdir(), f"ptnsbc-{os.getuid()}-{zlib.crc32(bytes(HERE))}.lock")
    locks = file.open("a")  # until we end
    compile_law = Dispatcher.compile

    def compile_or_read(self: Dispatcher, signature: object) -> object:
        byte = zlib.crc32(f"{self.py_func.__module__}.{self.py_func.__qualname__}".encode())
        with suppress(OSError):  # two of us would wait for each other: one compiles it again
            fcntl.lockf(locks, fcntl.LOCK_EX, 1, byte)
        try:
            return compile_law(self, signature)
        finally:
            fcntl.lockf(locks, fcntl.LOCK_UN, 1, byte)

    Dispatcher.compile = compile_or_read


@pytest.fixture(scope="session", autouse=True)
def runtime_folder() -> Iterator[Path]:
    """A folder for sockets and orders that no fleet of this host uses; its path is short, as a socket's must be."""
    with tempfile.TemporaryDirectory(prefix="pt-") as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", folder)
        yield Path(folder)


@pytest.fixture(autouse=True)
def nothing_holds(runtime_folder: Path) -> Iterator[None]:
    """Orders hold until they are released, and records of dead bridges stay: not for the next test."""
    yield
    for domain in runtime_folder.glob("ptnsbc/*"):
        release(domain)
        forget_dead(domain)


def pytest_addoption(parser: pytest.Parser) -> None:
    """For `make test`, whose summary is of two runs."""
    parser.addoption("--counts", type=Path, help="write the numbers of passed, failed … to a file")


def pytest_configure(config: pytest.Config) -> None:
    """Judge flights in real time by the machine they had."""
    config.pluginmanager.register(real_time.RealTime())
    if worker := os.environ.get("PYTEST_XDIST_WORKER"):
        _each_law_is_compiled_once()
        if [Path(argument).resolve() for argument in config.args] == [HERE]:
            # Each begins elsewhere: pytest rewrites the assertions of a file once, and the others read what it wrote.
            files = sorted(map(str, HERE.rglob("test_*.py")))
            workers = int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
            at = len(files) * int(worker.removeprefix("gw")) // workers
            config.args = files[at:] + files[:at]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object | None:
    """A file belongs to one worker, and all tests of the laws to the one that compiles them.

    numba keeps what it has typed: in one process the same laws take half the time of a processor.
    """

    from xdist.scheduler import LoadFileScheduling

    class ByFile(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return "tests/core" if nodeid.startswith("tests/core/") else nodeid.split("::")[0]

    return ByFile(config, log) if config.getoption("dist") == "loadfile" else None


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Write the file of `--counts`; a test that could not begin or end has failed."""
    file = terminalreporter.config.getoption("counts")
    if file:
        counts = {kind: len(terminalreporter.stats.get(kind, ())) for kind in COUNTED}
        counts["failed"] += len(terminalreporter.stats.get("error", ()))
        file.write_text(json.dumps(counts), encoding="utf-8")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long tests before short ones: no worker is left with one when the others have run out of work.

    Before them, on an empty cache one worker compiles the laws with the first test, while what needs none keeps
    the others busy. Everything else stands in the order of the files, wherever the worker began.
    """
    items.sort(key=lambda item: (_turn(item), item.path))
    for item in items:
        place = "nodes/" if "slow" in item.keywords else "support/"
        if "alone" in item.keywords and not _place(item).startswith(place):
            raise pytest.UsageError(
                f"{item.nodeid}: run.py looks for tests marked `alone` in tests/{place} only"
            )


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[object]:
    """Modules and tests stay until the end: no collection of garbage goes through them, now or later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.fixture(autouse=True)
def signal_handlers() -> Iterator[None]:
    """A test that runs the `main` of a process leaves no handler behind for the tests after it."""
    yield
    if "ptnsbc_nodes.runtime.signals" in sys.modules:
        sys.modules["ptnsbc_nodes.runtime.signals"].restore_handlers()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Who needs the laws waits for the worker that compiles them, instead of compiling the same beside it."""
    turn = _turn(item)
    with Path(__file__).open() as lock:
        if turn != WITHOUT:
            fcntl.flock(lock, fcntl.LOCK_EX if turn == COMPILES else fcntl.LOCK_SH)
        if turn != COMPILES:
            lock.close()
        return (yield)


def _place(item: pytest.Item) -> str:
    return os.path.relpath(item.path, HERE)


def _turn(item: pytest.Item) -> int:
    if "compiles" in item.keywords:
        return COMPILES
    if _place(item).startswith("core/"):
        return LAWS
    if _place(item).startswith(WITHOUT_LAWS):
        return WITHOUT
    return LONG if "slow" in item.keywords else SHORT
