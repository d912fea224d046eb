"""Memory of the encounters with near objects: when each began, and on which side it is passed.

Near objects carry no identity, so an encounter is recognised by its place. Rows (8, 7): x y z [m, ENU],
side (+1 along e_z x n, -1 against), time binding [s], time since it bound last [s], used.
"""

from __future__ import annotations

import numpy as np

from ptnsbc_core.algebra import dot3, minus, put3
from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.types import Array, ClearanceConfig, Triple, Vector3

SLOTS = 8
SIDE, ACTIVE_S, QUIET_S, USED = 3, 4, 5, 6
SAME_PLACE_M = 1.0


@kernel
def none_met() -> Array:
    """An empty memory (8, 7)."""
    return np.zeros((SLOTS, 7))


@leaf
def find(encounters: Array, centre: Triple) -> int:
    """Slot of the encounter nearest to `centre` within SAME_PLACE_M, or -1."""
    best = -1
    least = SAME_PLACE_M * SAME_PLACE_M
    for slot in range(SLOTS):
        if encounters[slot, USED] == 0.0:
            continue
        off = minus(encounters[slot], centre)
        square = dot3(off, off)
        if square < least:
            least = square
            best = slot
    return best


@leaf
def any_met(encounters: Array) -> bool:
    """Whether any slot is in use."""
    met = 0.0
    for slot in range(SLOTS):
        met += encounters[slot, USED]
    return met > 0.0


@kernel
def active_time(encounters: Array, centre: Vector3) -> float:
    """How long the encounter at `centre` has been binding [s]; 0 for a new one."""
    slot = find(encounters, centre)
    if slot < 0:
        return 0.0
    return float(encounters[slot, ACTIVE_S])


@kernel
def _open(encounters: Array, side: float) -> int:
    """Claim a free slot, or the one that has been quiet longest."""
    slot = 0
    for candidate in range(SLOTS):
        if encounters[candidate, USED] == 0.0:
            slot = candidate
            break
        if encounters[candidate, QUIET_S] > encounters[slot, QUIET_S]:
            slot = candidate
    encounters[slot, SIDE] = -1.0 if side < 0.0 else 1.0
    encounters[slot, ACTIVE_S] = 0.0
    encounters[slot, QUIET_S] = np.inf
    encounters[slot, USED] = 1.0
    return slot


@kernel
def update(
    encounters: Array, near: Array, binding: Array, side: Array, dt: float, config: ClearanceConfig
) -> Array:
    """Memory after a tick in which the objects with a positive `binding` (M,) changed the velocity.

    A new encounter passes on the side to which `side` (M,) points; one that lasts longer than timeout_s
    tries the other side; one that is quiet for forget_s has ended.
    """
    out = encounters.copy()
    for slot in range(SLOTS):
        if out[slot, USED] > 0.0:
            out[slot, QUIET_S] += dt
            if out[slot, QUIET_S] > config.forget_s:
                out[slot, USED] = 0.0
    for m in range(binding.shape[0]):
        if binding[m] <= 0.0:
            continue
        slot = find(out, near[m])
        if slot < 0:
            slot = _open(out, side[m])
        put3(out[slot], 0, near[m])
        if out[slot, QUIET_S] > 0.0:  # once a tick, also when two near objects share the place
            out[slot, ACTIVE_S] += dt
        out[slot, QUIET_S] = 0.0
        if out[slot, ACTIVE_S] > config.timeout_s:
            out[slot, SIDE] = -out[slot, SIDE]
            out[slot, ACTIVE_S] = 0.0
    return out
