"""The transcripts in `docs/tutorial.md`: what commands print on a terminal of 80 columns."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from functools import cache

COLUMNS = 80
COMMANDS = {
    "help": ("--help",),
    "check": ("check", "paper_5", "-n", "5"),
    "simulate": ("simulate", "paper_5", "--duration", "12"),
    "refused": ("check", "paper_5", "--set", "gains.formation.deadline_s=2"),
}


def regions() -> dict[str, str]:
    """Every made region of the page, one for each transcript."""
    return {name: f"```text\n{transcript(*words)}\n```" for name, words in COMMANDS.items()}


@cache
def transcript(*words: str) -> str:
    """The standard output of a command on a terminal without colours, of 80 columns."""
    screen, terminal = os.openpty()
    settings = {**os.environ, "COLUMNS": str(COLUMNS), "TERM": "dumb"}
    command = [sys.executable, "-m", "ptnsbc_tools", *words]
    with (
        os.fdopen(screen, "rb") as shown,
        subprocess.Popen(command, stdout=terminal, stderr=subprocess.DEVNULL, env=settings),
    ):
        os.close(terminal)
        text = b""
        with suppress(OSError):  # which Linux raises at the end of a terminal
            while part := os.read(shown.fileno(), 65536):
                text += part
    lines = text.decode().replace("\r\n", "\n").splitlines()
    return "\n".join([f"$ ptnsbc {' '.join(words)}", *(line.rstrip() for line in lines)])
