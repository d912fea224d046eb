"""The transcripts in `docs/tutorial.md`: what commands print on a terminal of 80 columns."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

PAGE = Path(__file__).resolve().parents[1] / "tutorial.md"
DEMO = "demo"
_BAG = "out/demo-20260101-120000"  # a demo names it by the time of day
COLUMNS = 80
COMMANDS = {
    "help": ("--help",),
    "check": ("check", "paper_5", "-n", "5"),
    "simulate": ("simulate", "paper_5", "--duration", "12"),
    "sweep": tuple(
        [
            "sweep",
            "paper_5_free",
            "-n",
            "20",
            "--starts",
            "near:0.5",
            "--stop-after",
            "10",
            "-o",
            "out/near",
        ]
    ),
    "refused": ("check", "paper_5", "--set", "gains.formation.deadline_s=2"),
}


def regions() -> dict[str, str]:
    """Every made region of the page, one for each transcript."""
    shown = {DEMO: demo(), **{name: transcript(*words) for name, words in COMMANDS.items()}}
    return {name: f"```text\n{text}\n```" for name, text in shown.items()}


def demo() -> str:
    """The transcript of `ptnsbc demo`, whose fleet has the flight, and so the verdict, of one process."""
    _, _, printed = transcript("simulate", "paper_5").partition("\n")
    verdict, _, _ = printed.rpartition("next: ")
    places = f"bag: {_BAG}\npicture: {_BAG}.png\nreport: ptnsbc report {_BAG}"
    return f"$ ptnsbc demo\n{verdict}{places}"


@cache
def transcript(*words: str) -> str:
    """The standard output of a command in an empty folder, on a terminal without colours, of 80 columns."""
    screen, terminal = os.openpty()
    settings = {**os.environ, "COLUMNS": str(COLUMNS), "TERM": "dumb"}
    command = [sys.executable, "-m", "ptnsbc_tools", *words]
    with (
        os.fdopen(screen, "rb") as shown,
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(
            command, stdout=terminal, stderr=subprocess.DEVNULL, env=settings, cwd=folder
        ),
    ):
        os.close(terminal)
        text = b""
        with suppress(OSError):  # which Linux raises at the end of a terminal
            while part := os.read(shown.fileno(), 65536):
                text += part
    lines = text.decode().replace("\r\n", "\n").splitlines()
    return "\n".join([f"$ ptnsbc {' '.join(words)}", *(line.rstrip() for line in lines)])
