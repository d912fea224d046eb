"""The transcripts in `docs/tutorial.md`: what commands print on a terminal of 80 columns.

`python -m docs.make.tutorial` makes that of `ptnsbc demo`, whose flight takes longer than all the others together.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

from docs.make.markdown import region, remade
from ptnsbc_io.files import replacing

PAGE = Path(__file__).resolve().parents[1] / "tutorial.md"
DEMO = "demo"
_BEGAN = re.compile(r"\bdemo-\d{8}-\d{6}")  # the folder of a demo is named by the time of day
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
    """Every made region of the page, one for each transcript; that of the demo as it is."""
    made = {name: f"```text\n{transcript(*words)}\n```" for name, words in COMMANDS.items()}
    return {DEMO: region(PAGE.read_text("utf-8"), DEMO), **made}


def demo() -> str:
    """The region of the demo, which is flown for it; its folder has the time of day of no flight."""
    return f"```text\n{_BEGAN.sub('demo-20260101-120000', transcript(DEMO))}\n```"


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


def main() -> None:
    """Put the transcript of a demo that is flown now into the page."""
    page = PAGE.read_text("utf-8")
    others = {name: region(page, name) for name in COMMANDS}
    with replacing(PAGE) as part:
        part.write_text(remade(page, {**others, DEMO: demo()}), encoding="utf-8")


if __name__ == "__main__":
    main()
