"""One function for all laws: it flies a scenario by our method or by a baseline.

ours               the method, as `swarm.fly`
ptsmc_exponential  predefined-time sliding mode, exponential reaching function
ptsmc_two_sided    the same with a two-sided power reaching function
linear_cascade     ours without any time base: constant gains, tuned to settle in the same time
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from paper.baselines.reaching import EXPONENTIAL, TWO_SIDED, Reaching
from paper.baselines.settling import BaselineError, settled_s, tuned
from paper.baselines.terminal import Axis, Terminal, terminal_step
from ptnsbc_core.kernel import kernel, kernel_list
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import Vector3
from ptnsbc_sim import swarm
from ptnsbc_sim.disturbances.build import Disturbances
from ptnsbc_sim.scenario import Scenario, scenario_from_text
from ptnsbc_sim.swarm import HeadlessFlight
from ptnsbc_sim.tick import SwarmState, advance_plant, inputs_of, sense
from ptnsbc_sim.track import note

Progress = Callable[[int, int], None]

# Powers below 1/2 that ask least of the leader of paper_5 at the start: the baselines at their best.
_REACHING = {"ptsmc_exponential": (EXPONENTIAL, 0.3), "ptsmc_two_sided": (TWO_SIDED, 0.4)}

LAWS = ("ours", *_REACHING, "linear_cascade")

_ROBUST = (0.6, 0.4)  # [m/s^2], [rad/s^2]: one and a half to two times the disturbances of Table 2
_WIDTH = (0.05, 0.1)  # [m/s], [rad/s]: as wide as the boundaries of our controller
_LONGER = 2.0  # deadlines that a flight is watched for while a gain is tuned
_ACCELERATION = "gains.filter.max_acceleration_m_s2"
_WIDER = 2.0  # how much higher the limit of the command filter may be for a cascade
_SPARE = 1.05  # the gentlest gain is just not outside the band for good, and any other limit puts it there
_IN_BAND = 3.912  # ln 50: time constants until 2 % of an error are left


@kernel
def _fly_terminal(
    first: int,
    count: int,
    swarm_state: SwarmState,
    disturbances: Disturbances | None,
    laws: Sequence[Terminal],
) -> None:
    """As the loop of the swarm, with another law; wind does not act on this plant."""
    dt = seconds(swarm_state.wiring.dt_ns)
    for tick in range(first, first + count):
        t = seconds(tick * swarm_state.wiring.dt_ns)
        sense(swarm_state, tick, disturbances)
        for row in range(swarm_state.bodies.shape[0]):
            inputs = inputs_of(swarm_state, tick, row, disturbances)
            swarm_state.states[row], out = terminal_step(
                swarm_state.states[row], inputs, t, dt, swarm_state.configs[row], laws[row]
            )
            note(swarm_state.track, tick, row, out)
            advance_plant(swarm_state, tick, row, disturbances)


def _place(scenario: Scenario, uav_id: int) -> Vector3:
    x, y, z = scenario.offset(uav_id).tolist()
    return x, y, z


def _changed(scenario: Scenario, changes: Mapping[str, Any]) -> Scenario:
    return scenario_from_text(scenario.text, changes, source=scenario.source)


def _axis(kind: int, power: float, deadline_s: float, which: int) -> Axis:
    """Half of the deadline is for reaching s = 0, half for sliding to e = 0."""
    half = Reaching(kind, 0.5 * deadline_s, power)
    return Axis(half, half, _ROBUST[which], _WIDTH[which])


def _terminal(scenario: Scenario, law: str) -> list[Terminal]:
    kind, power = _REACHING[law]
    gains = scenario.gains
    position = _axis(kind, power, float(gains.formation.deadline_s), 0)
    attitude = _axis(kind, power, float(gains.attitude.deadline_s), 1)
    return [Terminal(_place(scenario, uav), position, attitude) for uav in scenario.uav_ids]


def fly_tuned(scenario: Scenario, law: str, progress: Progress | None = None) -> HeadlessFlight:
    """One flight by a law that `law_scenario` has tuned, from the starts of this scenario."""
    if law not in _REACHING:
        return swarm.fly(scenario, progress)
    if scenario.formation.has_open_slots:
        raise BaselineError(
            f"law {law} with formation.assignment {scenario.formation.assignment}: expected fixed"
        )
    laws = kernel_list(_terminal(scenario, law))

    def loop(
        first: int, count: int, swarm_state: SwarmState, disturbances: Disturbances | None
    ) -> None:
        _fly_terminal(first, count, swarm_state, disturbances, laws)

    return swarm.fly(scenario, progress, loop=loop)


def without_time_base(scenario: Scenario, kappa_1_s: float) -> Scenario:
    """Constant gains in all loops: kappa for the formation, and for the attitude a gain that meets its deadline."""
    loops = ("formation", "attitude", "estimator", "force", "torque")
    changes: dict[str, Any] = {f"gains.{loop}.time_base": False for loop in loops}
    changes["gains.formation.scale"] = 1.0
    changes["gains.formation.kappa_1_s"] = kappa_1_s
    changes["gains.attitude.scale"] = 1.0
    changes["gains.attitude.kappa_1_s"] = _IN_BAND / scenario.gains.attitude.deadline_s
    return _changed(scenario, changes)


def _with(scenario: Scenario, law: str, value: float) -> Scenario:
    """The scenario with the tuned value: the constant gain (linear_cascade) or the nominal deadline (others)."""
    if law == "linear_cascade":
        return without_time_base(scenario, value)
    return _changed(scenario, {"gains.formation.deadline_s": value})


def _settles(scenario: Scenario, law: str, watched_s: float) -> Callable[[float], float | None]:
    """Settling time of the law in free space, as a function of the tuned value."""
    free = _changed(scenario, {"world.obstacles": [], "timing.duration_s": watched_s})
    return lambda value: settled_s(fly_tuned(_with(free, law, value), law))


def _ladder(law: str, settle_s: float) -> list[float]:
    """Values from gentle to firm. The first constant gain leaves 2 % of an error at `settle_s`."""
    if law == "linear_cascade":
        return [_IN_BAND / settle_s * 1.08**step for step in range(25)]
    return [8.0 * settle_s * 0.8**step for step in range(16)]


def _watched_s(settle_s: float) -> float:
    return max(_LONGER * settle_s, settle_s + 2.0)


def _tuned(scenario: Scenario, law: str, settle_s: float) -> Scenario:
    """The scenario with the gentlest value that settles in time."""
    settles = _settles(scenario, law, _watched_s(settle_s))
    return _with(scenario, law, tuned(settles, settle_s, _ladder(law, settle_s)))


def opened(scenario: Scenario, settle_s: float) -> Scenario:
    """The scenario of `linear_cascade` with the lowest limit of the command filter that settles in time.

    With the scenario's filter it may be that no constant gain settles in time, because the filter limits the
    command at the start. First the gentlest gain is found with twice the acceleration limit, then the lowest limit
    for a slightly larger gain.

    Raises:
        BaselineError: no gain settles in time with twice the limit either.
    """
    law, limit = "linear_cascade", float(scenario.gains.filter.max_acceleration_m_s2)
    wide = _tuned(_changed(scenario, {_ACCELERATION: _WIDER * limit}), law, settle_s)
    gain = _SPARE * float(wide.gains.formation.kappa_1_s)
    found = _changed(wide, {"gains.formation.kappa_1_s": gain})
    free = _changed(found, {"world.obstacles": [], "timing.duration_s": _watched_s(settle_s)})

    def settles(acceleration: float) -> float | None:
        return settled_s(fly_tuned(_changed(free, {_ACCELERATION: acceleration}), law))

    ladder = np.geomspace(limit, _WIDER * limit, 9).tolist()
    return _changed(found, {_ACCELERATION: tuned(settles, settle_s, ladder)})


def earliest_s(scenario: Scenario) -> float:
    """Earliest settling time [s] of `linear_cascade` in free space over the gains that tuning tries.

    Raises:
        BaselineError: it settles with no gain.
    """
    law, deadline_s = "linear_cascade", float(scenario.gains.formation.deadline_s)
    settles = _settles(scenario, law, _LONGER * deadline_s)
    found = [settles(value) for value in _ladder(law, deadline_s)]
    times = [time for time in found if time is not None]
    if not times:
        raise BaselineError(f"{law}: no constant gain settles within {_LONGER * deadline_s:g} s")
    return min(times)


def law_scenario(
    scenario: Scenario,
    law: str,
    actuator_limit_n: float | None = None,
    settle_s: float | None = None,
    *,
    open_filter: bool = False,
) -> Scenario:
    """The scenario as a law flies it: tuned from the starts of this scenario, and with limited actuators.

    Args and errors are those of `fly`.
    """
    if law not in LAWS:
        raise BaselineError(f"law {law!r}: expected one of {', '.join(LAWS)}")
    if law != "ours" and scenario.plant.kind != "rigid_body_6dof":
        raise BaselineError(
            f"law {law} with plant.kind {scenario.plant.kind}: expected rigid_body_6dof, "
            "the baselines command six forces and torques"
        )
    if law == "linear_cascade" and settle_s is None:
        settle_s = scenario.gains.formation.deadline_s
    if settle_s is not None:
        wide = open_filter and law == "linear_cascade"
        scenario = opened(scenario, settle_s) if wide else _tuned(scenario, law, settle_s)
    if actuator_limit_n is not None:
        scenario = _changed(scenario, {"plant.rigid_body.max_force_n": float(actuator_limit_n)})
    return scenario


def fly(
    scenario: Scenario,
    law: str = "ours",
    actuator_limit_n: float | None = None,
    settle_s: float | None = None,
    progress: Progress | None = None,
    *,
    open_filter: bool = False,
) -> HeadlessFlight:
    """Fly a scenario by one of LAWS.

    Args:
        scenario: what to fly; the plant is rigid_body_6dof but for `ours`.
        law: one of LAWS.
        actuator_limit_n: largest force [N]; by default the scenario's.
        settle_s: tune the law to settle by then: its constant gain (`linear_cascade`, by default to
            the deadline), else its nominal deadline (by default the scenario's). Without actuator
            limit and obstacles: a law is tuned for what it was made for.
        progress: called with (ticks done, ticks in all) now and then.
        open_filter: `linear_cascade` gets a command filter that lets it settle in time, see `opened`.

    Returns:
        The flight; its scenario holds what was tuned.

    Raises:
        BaselineError: an unknown law, another plant, or a time that no value settles in: a constant
            gain that is firm at the start runs into the acceleration limit of the command filter.
    """
    tuned_scenario = law_scenario(
        scenario, law, actuator_limit_n, settle_s, open_filter=open_filter
    )
    return fly_tuned(tuned_scenario, law, progress)
