"""Help: the CPU time of `ptnsbc --help` and of every sub-command's, beside a Python that imports Typer and Rich."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Sequence

from bench.session import Plan, print_progress
from bench.table import Row, Target

_REFERENCE = ("-c", "import typer, typer.rich_utils")
_PROGRAM = ("-m", "ptnsbc_tools")
_TARGET_S = 0.3


def measure(plan: Plan) -> Sequence[Row]:
    """Rows of this section: the whole program's help, and the slowest of the sub-commands'."""
    from typer.main import get_command

    from ptnsbc_tools.cli import app

    runs = plan.of(5, 2)
    single = {name: _help_s(name, runs) for name in get_command(app).commands}  # type: ignore[attr-defined]
    slowest = max(single, key=lambda name: min(single[name]))  # other programs only add
    references = [_cpu_s(_REFERENCE) for _ in range(runs)]
    name, target = "import of Typer and its Rich parts", Target(_TARGET_S)
    whole = [_cpu_s((*_PROGRAM, "--help")) for _ in range(runs)]
    return [
        Row("CPU of ptnsbc --help", whole, "s", name, references, target=target),
        Row(f"slowest sub-command: {slowest} --help", single[slowest], "s", target=target),
    ]


def _help_s(name: str, runs: int) -> list[float]:
    print_progress(f"help: {name}")
    return [_cpu_s((*_PROGRAM, name, "-h")) for _ in range(runs)]


def _cpu_s(words: Sequence[str]) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *words], stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
