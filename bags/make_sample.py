"""Make `bags/sample` anew: `.venv/bin/python bags/make_sample.py` in a clean checkout.

Flies, records, judges; writes what it did into MANIFEST.json and the checksums into SHA256SUMS.
"""

from __future__ import annotations

import hashlib
import json
import platform
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "bags" / "sample"
FLIGHT = ("simulate", "paper_5_free", "--duration", "7.5", "--bag", "bags/sample", "--overwrite")
SHOWS = (
    "Simulation 1 of the paper without its obstacles: five quadrotors start tilted and out of place, "
    "are in formation before the deadline of 5 s, and keep it on the circle until 7.5 s."
)
LARGEST_BYTES = 1_500_000


def _output(*command: str) -> str:
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout


def _fly() -> dict[str, Any]:
    words = [sys.executable, "-m", "ptnsbc_tools.cli", *FLIGHT, "--json"]
    done = subprocess.run(words, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode > 1:
        raise SystemExit(done.returncode)
    verdict: dict[str, Any] = json.loads(done.stdout)
    return verdict


def _manifest(verdict: dict[str, Any]) -> dict[str, Any]:
    kept = ("uav", "verdict", "settling_s", "error_at_deadline_m")
    return {
        "shows": SHOWS,
        "command": " ".join(("ptnsbc", *FLIGHT)),
        "made_by": "bags/make_sample.py",
        "commit": _output("git", "rev-parse", "HEAD").strip(),
        "clean": not _output("git", "status", "--porcelain", "--untracked-files=no", ":!bags"),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in ("numpy", "numba", "mcap")},
        "verdict": verdict["verdict"],
        "uavs": [{key: uav[key] for key in kept} for uav in verdict["uavs"]],
    }


def main() -> None:
    """Fly, describe, sign."""
    for name in ("MANIFEST.json", "SHA256SUMS"):  # --overwrite takes a folder with a bag alone
        (SAMPLE / name).unlink(missing_ok=True)
    manifest = _manifest(_fly())
    text = json.dumps(manifest, indent=2, ensure_ascii=False)
    (SAMPLE / "MANIFEST.json").write_text(f"{text}\n", encoding="utf-8")
    files = sorted(path for path in SAMPLE.iterdir() if path.name != "SHA256SUMS")
    size = sum(path.stat().st_size for path in files)
    if size > LARGEST_BYTES:
        raise SystemExit(f"{SAMPLE}: {size} bytes: expected at most {LARGEST_BYTES}")
    sums = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in files]
    (SAMPLE / "SHA256SUMS").write_text("".join(sums), encoding="utf-8")
    print(f"{SAMPLE}: {size} bytes, verdict {manifest['verdict']}")


if __name__ == "__main__":
    main()
