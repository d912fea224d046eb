"""Memory of the near objects whose constraints were binding: for how long, and on which side each is passed.

Near objects carry no identity, so a slot belongs to the object nearest to its position. Rows (8, 7): x y z
[m, ENU], side (+1 along e_z x n, -1 against), time binding [s], time since it last was binding [s], used.
"""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import dot3, store3, sub3
from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.types import Array, ClearanceConfig, Vector3, Vector3Like

SLOTS = 8
SIDE, ACTIVE_S, QUIET_S, USED = 3, 4, 5, 6
MATCH_RADIUS_M = 1.0

_CHANGE = 0.25
"""The side changes from this share of timeout_s before it to the same share after it."""


@kernel
def empty_memory() -> Array:
    """An empty memory (8, 7)."""
    return np.zeros((SLOTS, 7))


@inline_kernel
def find_slot(memory: Array, centre: Vector3Like) -> int:
    """Used slot nearest to `centre` within MATCH_RADIUS_M, or -1."""
    nearest = -1
    least = MATCH_RADIUS_M * MATCH_RADIUS_M
    for slot in range(SLOTS):
        if memory[slot, USED] == 0.0:
            continue
        offset = sub3(memory[slot], centre)
        squared = dot3(offset, offset)
        if squared < least:
            least = squared
            nearest = slot
    return nearest


@inline_kernel
def any_used(memory: Array) -> bool:
    """True if any slot is in use."""
    used = 0.0
    for slot in range(SLOTS):
        used += memory[slot, USED]
    return used > 0.0


@kernel
def active_time(memory: Array, centre: Vector3) -> float:
    """The time for which the object at `centre` has been binding [s]; 0 for a new one."""
    slot = find_slot(memory, centre)
    if slot < 0:
        return 0.0
    return float(memory[slot, ACTIVE_S])


@inline_kernel
def side_of(memory: Array, slot: int, timeout_s: float) -> float:
    """Side on which an object is passed, -1 to 1: it changes around timeout_s, and again after another timeout_s.

    The change takes half of that time. A step would saturate the filter, and the tilt of the vehicle beside a slope
    would lead into it.
    """
    left = (timeout_s - memory[slot, ACTIVE_S]) / (_CHANGE * timeout_s)
    return memory[slot, SIDE] * min(max(left, -1.0), 1.0)


@kernel
def _claim_slot(memory: Array, side: float) -> int:
    """Take a free slot, or the one that was not binding for the longest time."""
    slot = 0
    for candidate in range(SLOTS):
        if memory[candidate, USED] == 0.0:
            slot = candidate
            break
        if memory[candidate, QUIET_S] > memory[slot, QUIET_S]:
            slot = candidate
    memory[slot, SIDE] = -1.0 if side < 0.0 else 1.0
    memory[slot, ACTIVE_S] = 0.0
    memory[slot, QUIET_S] = np.inf
    memory[slot, USED] = 1.0
    return slot


@kernel
def update(
    memory: Array, near: Array, binding: Array, side: Array, dt: float, config: ClearanceConfig
) -> Array:
    """Memory after a tick in which the objects with a positive `binding` (M,) changed the velocity.

    A new object is passed on the side to which `side` (M,) points. After timeout_s the side changes, see `side_of`. A
    slot that was not binding for forget_s is free again.
    """
    out = memory.copy()
    for slot in range(SLOTS):
        if out[slot, USED] > 0.0:
            out[slot, QUIET_S] += dt
            if out[slot, QUIET_S] > config.forget_s:
                out[slot, USED] = 0.0
    for m in range(binding.shape[0]):
        if binding[m] <= 0.0:
            continue
        slot = find_slot(out, near[m])
        if slot < 0:
            slot = _claim_slot(out, side[m])
        store3(out[slot], 0, near[m])
        if out[slot, QUIET_S] > 0.0:  # once per tick, also when two near objects share the slot
            out[slot, ACTIVE_S] += dt
        out[slot, QUIET_S] = 0.0
        if out[slot, ACTIVE_S] > (1.0 + _CHANGE) * config.timeout_s:
            out[slot, SIDE] = -out[slot, SIDE]
            out[slot, ACTIVE_S] -= config.timeout_s
    return out
