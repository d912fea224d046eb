"""Which code made the results."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path

from ptnsbc_sim.scenario import reader
from ptnsbc_tools.reproduce.flights import SCENARIOS, scenario

_ROOT = Path(__file__).resolve().parents[2]
_CODE = ("ptnsbc_core", "ptnsbc_sim", "ptnsbc_tools", "scenarios")
_LAWS = ("ptnsbc_core", "ptnsbc_sim")
_SHORT = 12


def commit() -> str:
    """Commit of the checkout, `+` when its code was changed since; `unknown` without one."""
    found = _git("rev-parse", f"--short={_SHORT}", "HEAD")
    if not found:
        return "unknown"
    return found + ("+" if _git("status", "--porcelain", "--", *_CODE) else "")


def _git(*words: str) -> str:
    try:
        done = subprocess.run(
            ("git", "-C", str(_ROOT), *words),
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()


def digest() -> str:
    """Digest of laws, simulator and shipped scenarios: the same numbers come from the same digest."""
    found = hashlib.sha256()
    files = [path for folder in _LAWS for path in (_ROOT / folder).rglob("*.py")]
    files += [reader.find(name) for name in SCENARIOS]
    for path in sorted(files):
        found.update(path.name.encode())
        found.update(path.read_bytes())
    return found.hexdigest()[:_SHORT]


def seeds() -> str:
    """The seeds of the scenarios, as they are flown."""
    by_seed: dict[int, list[str]] = {}
    for name in SCENARIOS:
        by_seed.setdefault(scenario(name).seed, []).append(f"`{name}`")
    return "; ".join(f"seed {seed} in {', '.join(names)}" for seed, names in by_seed.items())
