"""`python -m docs.make [--check]`: fill the made regions of the pages anew, and the schemas."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from docs.make import json_schemas
from docs.make.markdown import RegionError, remade
from ptnsbc_io.files import replacing
from ptnsbc_nodes.runtime import environment

DOCS = Path(__file__).resolve().parents[1]
PAGES = {
    "scenarios.md": "docs.make.scenarios",
    "missions.md": "docs.make.missions",
    "cli.md": "docs.make.cli",
    "architecture.md": "docs.make.architecture",
    "faults.md": "docs.make.faults",
    "shares.md": "docs.make.shares",
    "tutorial.md": "docs.make.tutorial",
}


def made(name: str) -> str:
    """The text that a page with made regions should have."""
    environment.prepare()  # before the nodes are imported
    text = (DOCS / name).read_text(encoding="utf-8")
    try:
        return remade(text, import_module(PAGES[name]).regions())
    except RegionError as error:
        raise RegionError(f"{DOCS / name}: {error}") from None


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 1 with --check when a file is not as it would be made, 2 for a page with wrong regions."""
    parser = argparse.ArgumentParser(prog="python -m docs.make", description="Make the pages.")
    parser.add_argument("--check", action="store_true", help="write nothing, print stale pages")
    check = parser.parse_args(arguments).check
    try:
        texts = {path: json_schemas.text(path) for path in json_schemas.SCHEMAS}
        texts |= {DOCS / name: made(name) for name in PAGES}
    except RegionError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    stale = {path: text for path, text in texts.items() if path.read_text("utf-8") != text}
    for path, text in stale.items():
        print(f"{path}: {'stale: make docs' if check else 'made anew'}")
        if not check:
            with replacing(path) as part:
                part.write_text(text, encoding="utf-8")
    return int(check and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
