"""`python -m paper.families`: fly the shipped families for the page that says how often they hold.

Each family is drawn at random, searched for its worst flights, and searched for the probability of a broken keep-out.
A folder for each keeps what was flown, so that the same command goes on. `docs/families/NAME.json` has the figures,
which `python -m docs.make` puts into `docs/shares.md`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from docs.make.shares import DATA, FAMILIES
from paper.experiment_result import rounded
from paper.report import commit
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_io.files import replacing
from ptnsbc_sim.scenario import load_scenario
from ptnsbc_sim.sweep.dry_run import ACCEPTED
from ptnsbc_sim.sweep.rows import MARGINS
from ptnsbc_sim.sweep.runner import run
from ptnsbc_sim.sweep.search import NO_MARGIN, Found, search
from ptnsbc_sim.verdict.deadline import VIOLATED
from ptnsbc_tools import console
from ptnsbc_tools.library.sweeping import plan
from ptnsbc_tools.sweeps.summary import FlownSweep, read_sweep, share_of

FLOWN = ("ptnsbc_core", "ptnsbc_sim", "scenarios")
SEED, CHECK = 4801, 20
RUNS, FLIGHTS, LEAST = 500, 20_000, 1e-4
PARTS = ("search", "rare", "sweep")


def searched(found: Found) -> dict[str, Any]:
    """The flights of a search, how many were refused, how many of the others broke a promise, and the least margins."""
    refused = (found.margins == NO_MARGIN).all(axis=1)
    others = found.margins[~refused]
    counts = {"flights": len(refused), "refused": int(refused.sum())}
    broken = {name: int(of.sum()) for name, of in zip(MARGINS, (others < 0.0).T, strict=True)}
    return counts | {"broken": broken, "worst": dict(zip(MARGINS, _least(others), strict=True))}


def _least(margins: Array) -> list[float | None]:
    """Of each promise (P,); None of one that no flight makes."""
    least = margins.min(axis=0, initial=NO_MARGIN)
    return [None if one == NO_MARGIN else float(one) for one in least]


def swept(sweep: FlownSweep) -> dict[str, Any]:
    """The shares of a sweep: accepted, and of these met, in place, and inside a keep-out; their closest pair [m].

    Without dry runs nothing is said of *accepted*, and the others are of all.
    """
    flights, asked = sweep.table.flights, bool(sweep.plan.check)
    accepted = flights.check == (ACCEPTED if asked else "")
    shares = {
        "accepted": share_of(accepted),
        "met": share_of(flights.met[accepted]),
        "in_place": share_of(flights.in_place[accepted]),
        "inside_keep_out": share_of((flights.verdict == VIOLATED)[accepted]),
    }
    found: dict[str, Any] = {name: one.as_json() for name, one in shares.items()}
    closest = sweep.table.of_flights("closest_uav_m")[accepted]
    found["closest_uav_m"] = float(np.min(closest, initial=np.inf))
    return found if asked else {**found, "accepted": None}


def checked(part: str, given: argparse.Namespace) -> int:
    """Flights of each dry run of a part: a probability is that of draws which nobody has refused."""
    return 0 if part == "rare" else given.check


def fly(family: str, part: str, given: argparse.Namespace) -> dict[str, Any]:
    """The figures of a part of a family, flown into a folder of its own, or read from there."""
    runs, workers = given.flights if part == "search" else RUNS, given.workers
    base = load_scenario("paper_5_free")
    draws = plan(base, runs, family=family, seed=SEED, check=checked(part, given))
    place = given.output / family / (part if given.check == CHECK else f"{part}-{given.check}")
    with console.progress(f"{family}, {part}") as progress:
        if part == "sweep":
            run(draws, place, workers=workers, progress=progress)
            return swept(read_sweep(place))
        if part == "search":
            return searched(search(draws, place, workers=workers, progress=progress))
        promise = MARGINS[0]
        found = search(
            draws, place, least=LEAST, promise=promise, workers=workers, progress=progress
        )
        return {} if found.rare is None else found.rare._asdict()


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 2 when a family cannot be flown."""
    parser = argparse.ArgumentParser(prog="python -m paper.families", description=__doc__)
    parser.add_argument("families", nargs="*", help=f"default: {' '.join(FAMILIES)}")
    parser.add_argument("--output", "-o", type=Path, default=Path("out/families"), metavar="DIR")
    parser.add_argument("--flights", type=int, default=FLIGHTS, help="of each search")
    parser.add_argument("--check", type=int, default=CHECK, help="flights of each dry run")
    parser.add_argument("--part", choices=PARTS, action="append", help="this part alone")
    parser.add_argument("--workers", "-j", type=int, default=2)
    given = parser.parse_args(arguments)
    try:
        for family in given.families or FAMILIES:
            for part in given.part or PARTS:
                about = {"seed": SEED, "check": checked(part, given), "commit": commit(FLOWN)}
                _keep(family, {part: {**fly(family, part, given), **about}})
    except PtnsbcError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _keep(family: str, figures: dict[str, Any]) -> None:
    """Replace the figures of these parts of a family."""
    path = DATA / f"{family}.json"
    before = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    DATA.mkdir(exist_ok=True)
    with replacing(path) as part:
        text = json.dumps(rounded(before | figures), indent=1, allow_nan=False)
        part.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
