"""`python -m bench [--quick] [--only NAME] [--json]`: measure, and print one table."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Sequence
from importlib import import_module

from bench.session import Machine, Plan, print_progress, sentences
from bench.table import Row, markdown
from ptnsbc_core.errors import PtnsbcError

SECTIONS = ("tick", "headless", "sweep", "startup", "fleets", "quarter", "peers")


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 1 when a section could not be measured; a missed target is no failure."""
    options = _parser().parse_args(argv)
    plan, machine = Plan(options.quick), Machine()
    rows: list[Row] = []
    failed: dict[str, str] = {}
    for section in options.only or SECTIONS:
        print_progress(f"{section} …")
        try:
            for row in import_module(f"bench.{section}").measure(plan):
                rows.append(dataclasses.replace(row, section=section))
        except (ImportError, PtnsbcError) as error:
            failed[section] = str(error)
            print_progress(f"{section} failed: {error}")
    facts = machine.facts()
    if options.json:
        measured = [row.as_json() for row in rows]
        print(
            json.dumps({"quick": plan.quick, "machine": facts, "rows": measured, "failed": failed})
        )
    else:
        print(markdown(rows, sentences(facts)))
    return int(bool(failed))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="bench", description="Measure what the pages quote.")
    parser.add_argument(
        "--only", action="append", choices=SECTIONS, metavar="NAME", help=", ".join(SECTIONS)
    )
    parser.add_argument("--quick", action="store_true", help="fewer and shorter runs")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    return parser


if __name__ == "__main__":
    sys.exit(main())
