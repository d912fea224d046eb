"""crazyflow: its compiled step under a constant attitude command; physics at 500 Hz, a tick is 10 ms as ours."""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version

import numpy as np
from crazyflow.control import Control
from crazyflow.sim import Sim

_SUBSTEPS = 5
_CALL_TICKS = 100


def ticks_per_s(worlds: int, drones: int, seconds: float) -> float:
    """Ticks per second of so many worlds with so many drones each."""
    sim = Sim(n_worlds=worlds, n_drones=drones, control=Control.attitude, freq=500)
    sim.reset()
    command = np.zeros((worlds, drones, 4))
    command[..., 3] = 0.3  # [N]
    sim.attitude_control(command)
    for _ in range(2):  # compiled before it counts
        sim.step(_SUBSTEPS * _CALL_TICKS)
        sim.data.states.pos.block_until_ready()
    ticks, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        sim.step(_SUBSTEPS * _CALL_TICKS)
        sim.data.states.pos.block_until_ready()
        ticks += _CALL_TICKS
    return ticks / (time.perf_counter() - began)


if __name__ == "__main__":
    for_s = float(sys.argv[1])
    swarm, batch = ticks_per_s(1, 5, for_s), ticks_per_s(5000, 1, for_s)
    name = f"crazyflow {version('crazyflow')}"
    print(json.dumps({"peer": name, "swarm": swarm, "drones": 5000 * batch}))
