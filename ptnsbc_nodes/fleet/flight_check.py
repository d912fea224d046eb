"""The check of a flight from where its vehicles are: before anything arms, and again before the formation begins.

No vehicle arms before its UAV process is active. The launcher keeps these processes inactive until all bridges
know where their vehicles stand, and a flight from there, at the take-off height, is not refused.
"""

from __future__ import annotations

import math

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.fleet.coordinator_node import Coordinator
from ptnsbc_nodes.fleet.process_list import FleetOptions
from ptnsbc_sim.sweep.dry_run import START_M, with_starts_at

SAME_M = 3 * START_M
"""Vehicles that are so near to where the flight was judged are not judged again: dry runs move starts that much."""
_POSITIONS_S = 5.0


class FlightCheck:
    """The checks of one flight, by `FleetOptions.objection`; each returns why the flight must not begin, or nothing."""

    def __init__(self, options: FleetOptions, coordinator: Coordinator) -> None:
        self._options, self._coordinator = options, coordinator
        self._judged: dict[int, tuple[float, ...]] = {}  # places from which it may begin
        self._met = False  # nothing speaks against arming
        if (options.objection is not None or options.wait) and options.backend == "mavlink":
            coordinator.held.update(f"uav{uav}" for uav in options.scenario.uav_ids)

    @property
    def holds(self) -> bool:
        """True if vehicles are kept from arming until `before_arming`."""
        return bool(self._coordinator.held)

    def located(self) -> bool:
        """True if all bridges know where their vehicles are."""
        return not self._lost()

    def refusal(self) -> str:
        """The reason why an operator must not let the vehicles arm now; empty when nothing speaks against it."""
        if self._options.backend != "mavlink":
            return "simulated vehicles need no arming: /formation/start begins the flight"
        if not self._options.wait:
            return "the vehicles arm by themselves: with --wait the fleet leaves it to an operator"
        if not self.holds:
            return "the vehicles may arm already"
        lost, vehicles = self._lost(), self._coordinator.vehicles
        if lost:
            steps = (f"{n}: {vehicles[n].step if n in vehicles else 'not heard'}" for n in lost)
            return "; ".join(steps)
        return "" if self._met else "dry runs from where the vehicles stand are flown: try again"

    def release(self) -> None:
        """Let the vehicles arm."""
        self._coordinator.held.clear()

    def _lost(self) -> list[str]:
        """Bridges that do not know where their vehicle is."""
        from ptnsbc_nodes.bridge.procedure.steps import OVER, Step  # needs pymavlink

        early = {one.value for one in (Step.HEARTBEAT, Step.PARAMETERS, Step.STATE, *OVER)}
        vehicles, places = self._coordinator.vehicles, self._coordinator.places
        names = [f"bridge{uav}" for uav in self._options.scenario.uav_ids]
        return [name for name in names if name not in places or vehicles[name].step in early]

    def before_arming(self) -> str:
        """Judge the flight from above where the vehicles stand; without an objection they may be released."""
        self._judged = {uav: self._in_the_air(uav) for uav in self._options.scenario.uav_ids}
        objection = self._objection(self._judged)
        self._met = not objection
        return objection

    def before_start(self) -> str:
        """Judge the flight from where the vehicles are; in lock-step they are where the file says."""
        options = self._options
        if options.objection is None or options.lockstep:
            return ""
        places = self._coordinator.positions(options.scenario.uav_ids, _POSITIONS_S)
        same = places.keys() == self._judged.keys() and all(
            math.dist(place, self._judged[uav]) <= SAME_M for uav, place in places.items()
        )
        return "" if same else self._objection(places)

    def _in_the_air(self, uav: int) -> tuple[float, ...]:
        """The place of the vehicle after the take-off (3,) [m]; it may be airborne already, in a pilot's hands."""
        name = f"bridge{uav}"
        x, y, z = self._coordinator.places[name]
        vehicle, height_m = self._coordinator.vehicles[name], 0.0
        if vehicle.landed or not vehicle.armed:
            height_m = self._options.scenario.mavlink.takeoff_height_m
        return x, y, z + height_m

    def _objection(self, places: dict[int, tuple[float, ...]]) -> str:
        judge = self._options.objection
        try:
            return "" if judge is None else judge(with_starts_at(self._options.scenario, places))
        except PtnsbcError as error:  # nobody may start from there
            return str(error)
