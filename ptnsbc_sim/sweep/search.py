"""A search for the worst flights of a sweep, and for the probability that one breaks a promise.

A draw is a point of D standard normal numbers, and each of these makes one number of the draw through the inverse of
its distribution (`Coordinates`). A flight has a margin for each promise: its share that is left, below 0 where it is
broken. `worst` and `rare` yield generations of points, and are sent the margins of their flights.
"""

from __future__ import annotations

import json
import math
import multiprocessing
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_io.files import replacing
from ptnsbc_sim.swarm import HeadlessFlight
from ptnsbc_sim.sweep.draws import SweepError
from ptnsbc_sim.sweep.dry_run import REFUSED, dry_run_says
from ptnsbc_sim.sweep.plan import SweepPlan, layout_of
from ptnsbc_sim.sweep.rows import MARGINS, fly_draw
from ptnsbc_sim.sweep.runner import CHUNK_DRAWS, Progress, cores, depend_on_parent, made_by
from ptnsbc_sim.verdict.deadline import KEPT

KEPT_FLIGHTS = 25
"""Worst flights of a search that are written as a sweep."""
FARTHEST = 3.0
"""A coordinate of the search for the worst stays within so many standard deviations."""
LEVEL_FLIGHTS = 1000
"""Flights of the first level of a subset simulation."""
_SPECIES = 8
_LEVEL_SHARE = 0.1
_STEP, _MOVES = 0.6, 0.44  # first step of the chains, and the share of steps that should move one
# Standard deviations of an interval of 95 %, more than 1.96 because levels are not independent, which the variance
# leaves out: held 90 to 99 of 100 half spaces of 1e-4 and of 1e-6, in 5 and in 39 dimensions.
_REACH = 2.25
NO_MARGIN = 10.0
"""Margin of a promise that a flight does not make, and of all promises of a flight that is not flown or refused."""

Evaluate = Callable[[Array], Array]
Generations = Generator[Array, Array, "Rare | None"]
"""Yields points (M, D), is sent their margins (M, promises), and returns what it found."""


class Rare(NamedTuple):
    """The probability of a flight that breaks a promise."""

    probability: float  # 0: none was found down to the level asked for
    low: float  # interval of 95 %
    high: float
    flights: int


def worst(dims: int, flights: int, seed: int) -> Generations:
    """CMA-ES in several species, each for another promise, which begin again elsewhere once they have converged."""
    from cmaes import CMA  # late: few ask for it

    seeds = np.random.default_rng(seed)
    bounds = np.tile([-FARTHEST, FARTHEST], (dims, 1))

    def begun() -> CMA:
        mean = np.clip(0.5 * seeds.standard_normal(dims), -1.0, 1.0)
        word = int(seeds.integers(2**31))
        return CMA(mean, 1.0, bounds=bounds, seed=word, population_size=CHUNK_DRAWS)

    species = [begun() for _ in range(_SPECIES)]
    for _ in range(math.ceil(flights / (_SPECIES * CHUNK_DRAWS))):
        points = np.array([[one.ask() for _ in range(CHUNK_DRAWS)] for one in species])
        margins = yield points.reshape(-1, dims)
        for number, (one, of) in enumerate(zip(species, np.split(margins, _SPECIES), strict=True)):
            promise = number % (of.shape[1] + 1)  # the last of them: whichever is least
            values = of.min(axis=1) if promise == of.shape[1] else of[:, promise]
            one.tell(list(zip(points[number], values.tolist(), strict=True)))
            if one.should_stop():
                species[number] = begun()
    return None


def rare(dims: int, least: float, seed: int) -> Generations:
    """Subset simulation (Au and Beck, Probabilistic Engineering Mechanics 16, 2001).

    P(margin < 0) is the product of conditional probabilities of about 0.1 each: of all flights, a tenth lies below a
    first level of the margin; of those that chains draw below it, a tenth lies below a second one. A chain steps by
    z' = sqrt(1 - s^2) z + s n with n normal, which keeps the normal distribution, and stays where z' is above the
    level; s follows the share that moves (Papaioannou et al., Probabilistic Engineering Mechanics 41, 2015).
    Variance of a level as theirs (eq. 29): (1 - p)(1 + g)/(N p), g from the correlation along the chains.
    """
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((LEVEL_FLIGHTS, dims))
    margins = (yield points).min(axis=1)
    chains, probability, variance, step = LEVEL_FLIGHTS, 1.0, 0.0, _STEP
    flown = LEVEL_FLIGHTS
    while True:
        level = max(float(np.quantile(margins, _LEVEL_SHARE, method="lower")), 0.0)
        below = margins < level if level == 0.0 else margins <= level
        share = float(below.mean())
        if share in (0.0, 1.0) or probability * share < least:  # 1: no chain leaves its place
            break
        variance += (1.0 - share) * (1.0 + _correlation(below, chains)) / (len(below) * share)
        probability *= share
        if level == 0.0:
            reach = math.exp(_REACH * math.sqrt(math.log1p(variance)))
            return Rare(probability, probability / reach, min(probability * reach, 1.0), flown)
        seeds, at = points[below], margins[below]
        chains, states = len(seeds), [(seeds, at)]
        for _ in range(math.ceil(LEVEL_FLIGHTS / chains) - 1):
            tried = math.sqrt(1.0 - step**2) * seeds + step * rng.standard_normal(seeds.shape)
            found = (yield tried).min(axis=1)
            flown += chains
            moves = found <= level
            step = min(step * math.exp(moves.mean() - _MOVES), 1.0)
            seeds, at = np.where(moves[:, None], tried, seeds), np.where(moves, found, at)
            states.append((seeds, at))
        # A chain's states stand one behind the other.
        points, margins = (np.stack(one, axis=1) for one in zip(*states, strict=True))
        points, margins = points.reshape(-1, dims), margins.reshape(-1)
    # Of so many none is below 0: a chain's states hang together, and it may stand where another does.
    independent = min(chains, len(np.unique(points, axis=0)))
    return Rare(0.0, 0.0, max(least, min(3.0 * probability / independent, 1.0)), flown)


def _correlation(below: NDArray[np.bool_], chains: int) -> float:
    """2 sum (1 - k n/N) rho(k) over lags k of n chains with N states in all; 0 of independent flights."""
    series = below.reshape(chains, -1).astype(np.float64)
    length = series.shape[1]
    centred = series - series.mean()
    variance = float((centred**2).mean())
    if length == 1 or variance == 0.0:
        return 0.0
    rho = [float((centred[:, :-k] * centred[:, k:]).mean()) / variance for k in range(1, length)]
    return max(2.0 * sum((1.0 - k / length) * of for k, of in enumerate(rho, start=1)), 0.0)


def fly_margins(plan_json: str) -> Array:
    """The margins (M, 3) of the flights of a plan, each the least of its UAVs; of `check`, those it accepts.

    A draw that cannot be flown, or that the dry run refuses, breaks nothing.
    """
    plan = SweepPlan.from_json(plan_json)
    found = np.full((plan.draws, len(MARGINS)), NO_MARGIN)
    room: HeadlessFlight | None = None
    for k in range(plan.draws):
        try:
            rows, _, room = fly_draw(plan, k, room)
            for column, name in enumerate(MARGINS):
                values = [value for row in rows if (value := getattr(row, name)) is not None]
                found[k, column] = np.nan_to_num(min(values, default=NO_MARGIN), nan=-NO_MARGIN)
            if rows[0].flight_verdict not in KEPT:  # for whatever reason: nothing is left of it
                found[k, 1] = min(found[k, 1], -1e-9)
            if plan.check and found[k].min() < 0.0 and dry_run_says(plan, k) == REFUSED:
                found[k] = NO_MARGIN
        except PtnsbcError:
            found[k] = NO_MARGIN
    return found


@dataclass(frozen=True)
class Found:
    """The worst flights of a search, and all margins."""

    plan: SweepPlan  # of its worst flights, the worst first
    margins: Array  # (flights, promises) of all that it flew, in their order
    rare: Rare | None

    def so_far(self) -> list[tuple[int, float]]:
        """The least margin after 10, 100, 1000 … flights, and after all."""
        counts = [10**power for power in range(1, 8) if 10**power < len(self.margins)]
        return [(n, float(self.margins[:n].min())) for n in (*counts, len(self.margins))]

    def inputs(self, k: int, most: int = 3) -> list[str]:
        """The numbers of worst flight k that are farthest from their middle: what made it."""
        names = [f"{name}[{i}]" for name, count in self.plan.layout for i in range(count)]
        point = self.plan.points[k]
        order = sorted(range(len(point)), key=lambda i: -abs(point[i]))[:most]
        return [f"{names[i]} {point[i]:+.1f} sigma" for i in order]

    def as_json(self) -> dict[str, Any]:
        """As plain data."""
        worst = sorted(self.margins.min(axis=1).tolist())[: len(self.plan.points)]
        rare = None if self.rare is None else self.rare._asdict()
        kept = ({"draw": k, "margin": of, "inputs": self.inputs(k)} for k, of in enumerate(worst))
        found = {"so_far": self.so_far(), "rare": rare, "worst": [*kept]}
        return {"flights": len(self.margins), **found}


def search(
    plan: SweepPlan,
    folder: Path,
    *,
    least: float | None = None,
    promise: str | None = None,
    workers: int | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Found:
    """Search the draws of a plan, as many flights as it has; the same numbers whatever the workers.

    Args:
        plan: what may be drawn; its ranges, starts and family are the space.
        folder: keeps the margins, so that a search that was ended goes on.
        least: ask for the probability of a broken promise, down to this one; None: for the worst flights.
        promise: the one of MARGINS that counts; None: all of them.
        workers: processes on this machine, by default one for each core.
        overwrite: begin anew where the folder holds another search.
        progress: called with (flights done, flights in all).

    Raises:
        SweepError: nothing varies, the folder holds another search, or a worker has ended.
    """
    plan = replace(plan, layout=layout_of(plan))
    dims = sum(count for _, count in plan.layout)
    if plan.cells > 1 or dims < 2:  # the seed of the noise alone is no space
        raise SweepError("search: expected ranges, starts or a family, and no list or grid")
    space = replace(plan, runs=0).to_json()  # more flights go on with the search
    asked = {"space": space, "least": least, "promise": promise, "made_by": made_by(plan)}
    told = json.dumps(asked)
    counted = [MARGINS.index(promise)] if promise else slice(None)
    about, kept = folder / "search.json", folder / "margins.npy"
    folder.mkdir(parents=True, exist_ok=True)
    if about.exists() and about.read_text(encoding="utf-8") != told:
        if not overwrite:
            raise SweepError(
                f"{folder}: holds another search: choose another folder, or overwrite it"
            )
        kept.unlink(missing_ok=True)
    with replacing(about) as part:
        part.write_text(told, encoding="utf-8")
    before = np.load(kept) if kept.exists() else np.empty((0, len(MARGINS)))
    if least is None:
        generations = worst(dims, plan.runs, plan.seed)
    else:
        generations = rare(dims, least, plan.seed)
    points, result = [next(generations)], None
    margins: list[Array] = []
    with _workers(plan, dims, workers or cores()) as map_over:
        while True:
            done = sum(map(len, margins))
            known = before[done : done + len(points[-1])]
            if len(known) < len(points[-1]):
                known = np.concatenate([*map_over(fly_margins, _plans(plan, points[-1]))])
                with replacing(kept) as part, part.open("wb") as file:
                    np.save(file, np.concatenate([*margins, known]))
            margins.append(known)
            if progress is not None:
                progress(done + len(known), max(plan.runs, done + len(known)))
            try:
                points.append(generations.send(known[:, counted]))
            except StopIteration as end:
                result = end.value
                break
    of = np.concatenate(margins)[:, counted]
    order = np.argsort(of.min(axis=1), kind="stable")[:KEPT_FLIGHTS]
    chosen = tuple(map(tuple, np.concatenate(points)[order].tolist()))
    return Found(replace(plan, points=chosen, runs=len(chosen)), of, result)


def _plans(plan: SweepPlan, points: Array) -> list[str]:
    """Plans that fly points (M, D), a chunk each."""
    chunks = [points[k : k + CHUNK_DRAWS].tolist() for k in range(0, len(points), CHUNK_DRAWS)]
    flown = (replace(plan, points=tuple(map(tuple, one)), runs=len(one)) for one in chunks)
    return [one.to_json() for one in flown]


@contextmanager
def _workers(plan: SweepPlan, dims: int, workers: int) -> Iterator[Callable[..., Iterator[Array]]]:
    """The `map` of a pool of processes, or of this one."""
    if workers == 1:
        yield map
        return
    # The laws are loaded before the workers are forked.
    fly_margins(*_plans(plan, np.zeros((1, dims))))
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("fork"), depend_on_parent)
    try:
        yield pool.map
    except BrokenProcessPool:
        raise SweepError("search: a worker process ended: the same command goes on") from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
