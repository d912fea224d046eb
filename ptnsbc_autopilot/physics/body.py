"""The physical vehicle under a stand-in: plant, estimate, battery, ground. Without MAVLink."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ptnsbc_autopilot.physics import airframe
from ptnsbc_autopilot.physics.airframe import PHYSICS_HZ, AirframeState, LoopGains
from ptnsbc_autopilot.physics.frames import PX4_HOME, Geodetic, Quaternion, attitude_swap, euler_of
from ptnsbc_autopilot.physics.navigation import QUALITIES, UPDATE_HZ, Navigation, ReceiverAccuracy
from ptnsbc_core.kernel import kernel_list
from ptnsbc_core.types import PLANT_QUADROTOR, Array
from ptnsbc_sim.plants.contract import PlantConfig
from ptnsbc_sim.plants.integrate import initial_state

_PERIOD_S = 1.0 / PHYSICS_HZ
_NAVIGATION_EVERY = PHYSICS_HZ // UPDATE_HZ
_MOST_CATCH_UP_S = 5.0

HOVER_ENDURANCE_S = 1500.0
_CELLS = 4
_FULL_V, _EMPTY_V = 4.2, 3.5


def default_plant() -> PlantConfig:
    """The quadrotor of the paper's tables with our limits, in still air."""
    still = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return PlantConfig(
        PLANT_QUADROTOR,
        1.2,
        (0.019, 0.019, 0.021),
        9.81,
        25.9,
        (1.5, 1.5, 0.3),
        0.02,
        0.1,
        np.zeros(3),
        still,
        still,
        still,
    )


@dataclass(frozen=True)
class VehicleDescription:
    """One vehicle: its plant, its start, and the accuracy of its positioning."""

    plant: PlantConfig = field(default_factory=default_plant)
    start_enu: Array = field(default_factory=lambda: np.zeros(3))  # (3,) [m], on the ground z = 0
    yaw_rad: float = 0.0  # ENU
    quality: ReceiverAccuracy = QUALITIES["plain"]
    origin_spread_m: float = 0.0
    datum: Geodetic = PX4_HOME  # where ENU is zero
    battery: float = 1.0  # charge at the start
    seed: int = 0

    def with_drag(self, drag_1_s: float) -> VehicleDescription:
        """The same with at least this specific drag [1/s]; the wind pushes as before."""
        drag = max(self.plant.drag, drag_1_s)
        wind = self.plant.wind * (self.plant.drag / drag if drag > 0.0 else 1.0)
        return replace(self, plant=self.plant._replace(drag=drag, wind=wind))


class KinematicState:
    """A state (13,) of the vehicle: its truth in the world, or its estimate from its own origin."""

    def __init__(self, values: Array) -> None:
        self._values = values

    @property
    def position_enu(self) -> Array:
        """Position (3,) [m]."""
        return self._values[0:3]

    @property
    def velocity_enu(self) -> Array:
        """Velocity (3,) [m/s]."""
        return self._values[7:10]

    @property
    def rates_flu(self) -> Array:
        """Body rates (3,) [rad/s]."""
        return self._values[10:13]

    @property
    def attitude_enu(self) -> Quaternion:
        """Attitude, FLU in ENU."""
        x, y, z, w = (float(v) for v in self._values[3:7])
        return Quaternion(w, x, y, z)

    @property
    def yaw_enu(self) -> float:
        """Yaw [rad]."""
        return euler_of(self.attitude_enu).yaw

    @property
    def heading_ned(self) -> float:
        """Heading [rad]."""
        return euler_of(attitude_swap(self.attitude_enu)).yaw


class VehiclePhysics:
    """State of one vehicle; `advance` moves it to a time."""

    def __init__(self, body: VehicleDescription, gains: LoopGains, t: float) -> None:
        self.body = body
        self.gains = gains
        self.target = airframe.no_target()
        self.battery = body.battery
        self.endurance_s = HOVER_ENDURANCE_S
        self.navigation = Navigation(body.quality, body.start_enu, body.origin_spread_m, body.seed)
        self._plants = kernel_list([body.plant])
        self._state = initial_state(body.start_enu, np.array((0.0, 0.0, body.yaw_rad)), body.plant)
        self._state[13] = 0.0
        self._loop = np.zeros(airframe.LOOP_SIZE)
        self._loop[airframe.CONTACT] = 1.0
        self._nav = np.zeros(13)
        self.truth, self.estimate = KinematicState(self._state), KinematicState(self._nav)
        self._start_t = t
        self._ticks = 0
        self._contact_t = t
        self._fly(0)

    def blow(self, east_m_s: float) -> None:
        """From now on the wind blows steadily towards the east [m/s]."""
        plant = self.body.plant._replace(wind=np.array([east_m_s, 0.0, 0.0]))
        self._plants = kernel_list([plant])

    @property
    def t(self) -> float:
        """Time of the physics [s]."""
        return self._start_t + self._ticks * _PERIOD_S

    def advance(self, t: float) -> None:
        """Move on to t [s] in whole physics periods; a pause of the host beyond 5 s is skipped."""
        due = int((t - self._start_t) * PHYSICS_HZ + 1e-6) - self._ticks
        if due > _MOST_CATCH_UP_S * PHYSICS_HZ:
            self._start_t += due * _PERIOD_S - _MOST_CATCH_UP_S
            due = int(_MOST_CATCH_UP_S * PHYSICS_HZ)
        while due > 0:
            count = min(due, _NAVIGATION_EVERY - self._ticks % _NAVIGATION_EVERY)
            self._fly(count)
            due -= count
            if self._ticks % _NAVIGATION_EVERY == 0:
                self._update_slow_states(1.0 / UPDATE_HZ)

    def _fly(self, count: int) -> None:
        craft = AirframeState(
            self._state, self._loop, self._nav, self.navigation.errors, self.target
        )
        airframe.fly(craft, self.gains, self._plants, self.t, _PERIOD_S, count)
        self._ticks += count

    def _update_slow_states(self, dt: float) -> None:
        """Update the slow states: estimation errors, battery, time on the ground."""
        self.navigation.update(dt, self.in_contact)
        load = (self.thrust_share / self.hover_share) ** 1.5
        self.battery = max(0.0, self.battery - (0.02 + 0.98 * load) * dt / self.endurance_s)
        if not self.in_contact:
            self._contact_t = self.t

    @property
    def in_contact(self) -> bool:
        """True if the vehicle stands on the ground."""
        return bool(self._loop[airframe.CONTACT])

    @property
    def standing_s(self) -> float:
        """The time for which it has been on the ground."""
        return self.t - self._contact_t if self.in_contact else 0.0

    @property
    def thrust_share(self) -> float:
        """Commanded thrust as a share of the largest."""
        return float(self._loop[airframe.THRUST_OUT])

    @property
    def hover_share(self) -> float:
        """Thrust that carries the weight, as a share of the largest."""
        return airframe.hover_share(self.body.plant)

    @property
    def battery_v(self) -> float:
        """Voltage of the battery."""
        return _CELLS * (_EMPTY_V + (_FULL_V - _EMPTY_V) * self.battery)

    def reboot(self) -> None:
        """Restart the estimator at the present position: motors off, a new origin."""
        self.target = airframe.no_target()
        self.navigation.restart(self.truth.position_enu.copy())
