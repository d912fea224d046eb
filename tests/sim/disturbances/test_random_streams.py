"""Random numbers by address: whoever asks, in whatever order, gets the same."""

import numpy as np

from ptnsbc_sim.disturbances import random_streams
from ptnsbc_sim.disturbances.random_streams import (
    BLOCK_TICKS,
    first_numbers,
    normal,
    uniform,
)

ADDRESS = (7, 0, 3)


def test_one_tick_alone_is_the_same_as_in_a_table() -> None:
    ticks = 2 * BLOCK_TICKS + 5
    table = first_numbers(ADDRESS, ticks, 6)
    assert table.shape == (ticks, 6)
    for tick in (ticks - 1, 0, BLOCK_TICKS, BLOCK_TICKS - 1, 17):
        assert normal(ADDRESS, tick, 6).tobytes() == table[tick].tobytes()
    lost = first_numbers(ADDRESS, ticks) < 0.3
    assert [uniform(ADDRESS, tick) < 0.3 for tick in range(ticks)] == lost.tolist()


def test_a_long_flight_takes_the_memory_of_one_block_of_a_stream() -> None:
    """A sim that kept all blocks grew by 10 %, and one that made a new array for each by 2 %."""
    address = (7, 0, 33)
    first = normal(address, 0, 3)
    before = first.tobytes()
    place = random_streams._newest(address, 3)._values.ctypes.data
    for tick in range(0, 10 * BLOCK_TICKS, 100):
        normal(address, tick, 3)
    newest = random_streams._newest(address, 3)
    assert newest._number == 9
    assert newest._values.ctypes.data == place
    assert first.tobytes() == before == first_numbers(address, 1, 3).tobytes()


def test_a_longer_table_begins_with_the_shorter_one() -> None:
    assert first_numbers(ADDRESS, 10, 3).tobytes() == first_numbers(ADDRESS, 3000, 3)[:10].tobytes()


def test_every_address_has_numbers_of_its_own() -> None:
    addresses = [(7, 0, 3), (8, 0, 3), (7, 1, 3), (7, 0, 4), (7, 2, 3, 4), (7, 2, 4, 3)]
    found = np.stack([first_numbers(address, 4000, 1)[:, 0] for address in addresses])
    mixed = np.corrcoef(found)
    assert np.abs(mixed - np.eye(len(addresses))).max() < 0.08  # five standard errors
    first, second = found[0, :BLOCK_TICKS], found[0, BLOCK_TICKS : 2 * BLOCK_TICKS]
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.16


def test_they_are_normal_and_uniform() -> None:
    found = first_numbers(ADDRESS, 20_000, 1)
    assert abs(found.mean()) < 0.04
    assert abs(found.std() - 1.0) < 0.03
    assert abs((first_numbers(ADDRESS, 20_000) < 0.05).mean() - 0.05) < 0.008
