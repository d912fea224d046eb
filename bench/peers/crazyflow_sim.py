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


def ticks_per_s(drones: int, seconds: float) -> float:
    """Ticks per second of one world with so many drones."""
    sim = Sim(n_worlds=1, n_drones=drones, control=Control.attitude, freq=500)
    sim.reset()
    command = np.zeros((1, drones, 4))
    command[..., 3] = 0.3  # [N]
    sim.attitude_control(command)
    sim.step(_SUBSTEPS * _CALL_TICKS)  # compiled before it counts
    ticks, began = 0, time.perf_counter()
    while time.perf_counter() - began < seconds:
        sim.step(_SUBSTEPS * _CALL_TICKS)
        sim.data.states.pos.block_until_ready()
        ticks += _CALL_TICKS
    return ticks / (time.perf_counter() - began)


if __name__ == "__main__":
    for_s = float(sys.argv[1])
    swarm, batch = ticks_per_s(5, for_s), ticks_per_s(5000, for_s)
    name = f"crazyflow {version('crazyflow')}"
    print(json.dumps({"peer": name, "swarm": swarm, "drones": 5000 * batch}))
