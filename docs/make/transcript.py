"""The transcript of a law outside the repository: `python -m docs.make.transcript` flies it and writes the page.

It makes a new folder, puts one file of a law into it, and runs every command there. `tests/docs/test_transcript.py`
does the same and compares.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "own_law.md"
LAW = ROOT / "examples" / "laws" / "consensus.py"
SCENARIO = "extends: paper_5_free\nname: mine\nlaw: my_law.py:consensus\n"
_SWEEP = "-n 20 --starts near:0.5 --stop-after 10 --seed 3 --workers 1 --no-report"
COMMANDS = (
    ("ptnsbc simulate mine.yaml --duration 8 --bag headless", 0, 2),
    ("ptnsbc fleet mine.yaml --lockstep --plain --duration 8 --bag lockstep", 0, 2),
    (f"python {ROOT}/examples/laws/same_bytes.py headless lockstep", 0, 1),
    ("ptnsbc replay lockstep --rerun", 2, 1),
    ("ptnsbc replay lockstep --rerun --law my_law.py:consensus", 0, 1),
    (f"ptnsbc sweep paper_5_free {_SWEEP} -o ours", 0, 1),
    (f"ptnsbc sweep mine.yaml {_SWEEP} -o own", 0, 1),
    ("ptnsbc compare ours own", 1, 17),
)
"""Each command, its exit code, and how many of its last lines are shown."""


def _run(command: str, code: int, lines: int, folder: Path) -> str:
    words = shlex.split(command)
    program = [sys.executable, *(["-m", "ptnsbc_tools"] if words[0] == "ptnsbc" else [])]
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [*program, *words[1:]],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": paths, "COLUMNS": "100"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode != code:
        raise SystemExit(f"{command}: exit code {done.returncode}, expected {code}:\n{done.stdout}")
    shown = [line.rstrip() for line in done.stdout.splitlines() if line.strip()][-lines:]
    text = "\n".join(shown).replace(f"{folder}/", "").replace(f"{ROOT}/", "")
    said = f"$ {command.replace(f'{ROOT}/', '')}\n{text}"
    return said + (f"\n(exit code {code})" if code else "")


def made() -> str:
    """The page: every command is run now.

    Raises:
        SystemExit: a command ended with another exit code than `COMMANDS` says.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "my_law.py").write_text(LAW.read_text("utf-8"), "utf-8")
        (folder / "mine.yaml").write_text(SCENARIO, "utf-8")
        said = "\n\n".join(_run(*one, folder) for one in COMMANDS)
    said = re.sub(r"(?m)^\s*flying: .*\n", "", said)
    head = (
        "# A law outside the repository\n\n"
        "`python -m docs.make.transcript` makes an empty folder, puts these two files into it, runs the commands, and "
        "writes this page.\n[laws.md](laws.md) explains each step.\n\n"
        f"`my_law.py`, {len(LAW.read_text('utf-8').splitlines())} lines:\n\n"
    )
    parts = [
        f"```python\n{LAW.read_text('utf-8')}```\n\n`mine.yaml`:\n\n```yaml\n{SCENARIO}```\n",
        f"The commands, each with its last lines:\n\n```\n{said}\n```\n",
    ]
    return head + "\n".join(parts)


def lasting(page: str) -> str:
    """The page without what another machine may say otherwise: seconds of the machine, and digits of lengths.

    Verdicts, counts of messages, steps and flights, shares, errors and exit codes stay.
    """
    text = re.sub(r"; ([\d.]+ s of flight) in [\d.]+ s", r"; \1", page)
    text = re.sub(r"[+-]?\d+\.\d{3,}", "#", text)  # the widths of a table follow its digits
    text = re.sub(r"[━─]+", "-", text)
    return re.sub(r" +", " ", text)


def main() -> None:
    """Write the page."""
    page = made()
    beside = PAGE.with_name(f".{PAGE.name}.part")
    beside.write_text(page, "utf-8")
    os.replace(beside, PAGE)


if __name__ == "__main__":
    main()
