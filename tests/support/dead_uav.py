"""A headless flight in which one UAV dies: its process is silent from then on, and its vehicle stays where it is."""

import numpy as np

from ptnsbc_core.step import step
from ptnsbc_sim.swarm import advance_plant, flown, inputs_of, sense
from ptnsbc_sim.track import note


def flight_with_a_death(scenario, uav_id, at_s):
    """The flight, and whether each UAV held at each tick (T, N)."""
    dead, dt = scenario.uav_ids.index(uav_id), scenario.dt_ns * 1e-9
    died, states, configs, holding = round(at_s / dt), [], [], []

    def sent(tick, sender):
        """The newest tick of which a message of this sender has arrived."""
        return min(tick, died) - 1 if sender == dead else tick - 1

    def silenced(inputs, wiring, track, tick, row):
        """The same inputs without what the dead UAV would have sent."""
        for name, sender in (("parent", wiring.parent[row]), ("leader", wiring.leader)):
            if sender == dead and tick > died:
                last = track.reported[sent(tick, sender), sender]
                age_s = (tick - sent(tick, sender)) * dt
                if name == "parent" or wiring.pinned[row]:
                    inputs = inputs._replace(**{name: last, f"{name}_age_s": age_s})
        for k in range(wiring.neighbour_count[row]):
            sender = wiring.neighbours[row, k]
            if sender == dead and tick > died:
                inputs.estimates[k] = track.estimate[sent(tick, sender), sender]
                inputs.estimate_age_s[k] = (tick - sent(tick, sender)) * dt
        return inputs

    def loop(first, count, wiring, swarm, track, disturbances):
        size = len(swarm.plants)
        if not states:
            states.extend(swarm.states[row] for row in range(size))
            configs.extend(swarm.configs[row] for row in range(size))
        for tick in range(first, first + count):
            sense(swarm, wiring, track, tick, disturbances)
            alive = [row for row in range(size) if row != dead or tick < died]
            holding.append(np.zeros(size, dtype=bool))
            for row in alive:
                inputs = inputs_of(swarm, wiring, track, tick, row, disturbances)
                inputs = silenced(inputs, wiring, track, tick, row)
                states[row], out = step(states[row], inputs, tick * dt, dt, configs[row])
                note(track, tick, row, out)
                holding[-1][row] = out.diagnostics.holding
            for row in range(size):
                if row in alive:
                    advance_plant(swarm, wiring, track, tick, row, disturbances)
                else:
                    swarm.bodies[row, 7:13] = 0.0

    return flown(scenario, loop), np.array(holding)
