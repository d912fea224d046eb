"""Random numbers by address: seed, purpose, UAV and tick. The order of the requests has no effect.

A swarm in one process, a sim node and a UAV node request numbers in different orders, and all must get the same
ones. Every stream is therefore divided into blocks of ticks, and each block has a generator of its own.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.types import Array

BLOCK_TICKS = 1024

# Purposes of streams.
POSITION, GUST, STATE_LINK, ESTIMATE_LINK, SENSOR, FAULT, OWN = 0, 1, 2, 3, 4, 5, 6

Address = tuple[int, ...]
"""Seed, purpose, and the ids of the UAVs that the stream concerns."""


def _generator(address: Address, block: int) -> np.random.Generator:
    seed, *words = address
    return np.random.Generator(
        np.random.Philox(np.random.SeedSequence(seed, spawn_key=(*words, block)))
    )


@lru_cache(maxsize=256)
def _normals(address: Address, block: int, width: int) -> Array:
    return _generator(address, block).standard_normal((BLOCK_TICKS, width))


@lru_cache(maxsize=256)
def _uniforms(address: Address, block: int) -> Array:
    return _generator(address, block).random(BLOCK_TICKS)


def normal(address: Address, tick: int, width: int) -> Array:
    """Standard normal numbers (width,) for one tick."""
    block, row = divmod(tick, BLOCK_TICKS)
    return _normals(address, block, width)[row]


def uniform(address: Address, tick: int) -> float:
    """One number in [0, 1) for one tick."""
    block, row = divmod(tick, BLOCK_TICKS)
    return float(_uniforms(address, block)[row])


def normals(address: Address, ticks: int, width: int) -> Array:
    """The numbers (ticks, width) of the first ticks."""
    blocks = range(-(-ticks // BLOCK_TICKS))
    return np.concatenate([_normals(address, block, width) for block in blocks])[:ticks]


def uniform_below(address: Address, ticks: int, share: float) -> NDArray[np.bool_]:
    """Whether the numbers of the first ticks (ticks,) are below `share`."""
    blocks = range(-(-ticks // BLOCK_TICKS))
    return np.concatenate([_uniforms(address, block) for block in blocks])[:ticks] < share
