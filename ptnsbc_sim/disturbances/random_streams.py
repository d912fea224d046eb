"""Random numbers by address: seed, purpose, UAV and tick. The order of the requests has no effect.

A swarm in one process, a sim node and a UAV node request numbers in different orders, and all must get the same
ones. Every stream is therefore divided into blocks of ticks, and each block has a generator of its own.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ptnsbc_core.types import Array

BLOCK_TICKS = 1024
_STREAMS = 1024  # of 254 vehicles in one sim

# Purposes of streams.
POSITION, GUST, STATE_LINK, ESTIMATE_LINK, SENSOR, FAULT, OWN = 0, 1, 2, 3, 4, 5, 6

Address = tuple[int, ...]
"""Seed, purpose, and the ids of the UAVs that the stream concerns."""


def generator(seed: int, *words: int) -> np.random.Generator:
    """The generator of an address: its numbers depend on the seed and on each of the words."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=words)))


def _fill(values: Array, address: Address, block: int) -> None:
    """Put the numbers of a block into `values`: normal (BLOCK_TICKS, width), or uniform (BLOCK_TICKS,)."""
    numbers = generator(*address, block)
    if values.ndim == 2:
        numbers.standard_normal(out=values)
    else:
        numbers.random(out=values)


def first_numbers(address: Address, ticks: int, *width: int) -> Array:
    """The numbers of the first ticks: standard normal (ticks, width), or in [0, 1) (ticks,) without a width."""
    values = np.empty((-(-ticks // BLOCK_TICKS), BLOCK_TICKS, *width))
    for block, part in enumerate(values):
        _fill(part, address, block)
    return values.reshape(-1, *width)[:ticks]


class _Newest:
    """The block from which the last number of a stream came; `width` 0 is for uniform numbers.

    Every block takes the place of the one before. A new array for each would leave gaps of its size in the memory of
    a process, which grew by up to 2 % in ten minutes.
    """

    def __init__(self, address: Address, width: int) -> None:
        self._address = address
        self._number = -1
        self._values = np.empty((BLOCK_TICKS, width) if width else BLOCK_TICKS)

    def row(self, tick: int) -> Array:
        """The numbers of a tick, which stay when the stream goes on."""
        block, row = divmod(tick, BLOCK_TICKS)
        if block != self._number:
            self._number = -1
            _fill(self._values, self._address, block)
            self._number = block
        return np.array(self._values[row])


_newest = lru_cache(maxsize=_STREAMS)(_Newest)


def normal(address: Address, tick: int, width: int) -> Array:
    """Standard normal numbers (width,) for one tick."""
    return _newest(address, width).row(tick)


def uniform(address: Address, tick: int) -> float:
    """One number in [0, 1) for one tick."""
    return float(_newest(address, 0).row(tick))
