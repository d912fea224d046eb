"""`python -m docs.make [--check]`: fill the made regions of the pages anew, and the schema of the verdict."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from docs.make.markdown import RegionError, remade
from ptnsbc_tools.verdict import schema

DOCS = Path(__file__).resolve().parents[1]
PAGES = {"scenarios.md": "docs.make.scenarios", "cli.md": "docs.make.cli"}


def made() -> dict[Path, str]:
    """Every file that is made, wholly or in part, and what it should hold."""
    found = {DOCS / "verdict.schema.json": schema.text()}
    for name, module in PAGES.items():
        path = DOCS / name
        try:
            found[path] = remade(path.read_text(encoding="utf-8"), import_module(module).regions())
        except RegionError as error:
            raise RegionError(f"{path}: {error}") from None
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 1 with --check when a file is not as it would be made, 2 for a page with wrong regions."""
    parser = argparse.ArgumentParser(prog="python -m docs.make", description="Make the pages.")
    parser.add_argument("--check", action="store_true", help="write nothing, say what is stale")
    check = parser.parse_args(arguments).check
    try:
        stale = [item for item in made().items() if item[0].read_text("utf-8") != item[1]]
    except RegionError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for path, text in stale:
        print(f"{path}: {'stale: make docs' if check else 'made anew'}")
        if not check:
            beside = path.with_name(f".{path.name}.part")
            beside.write_text(text, encoding="utf-8")
            os.replace(beside, path)
    return int(check and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
