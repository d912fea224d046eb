"""The knowledge of a viewer of a flight now: places, errors, time to the deadline, faults. Without ROS."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from ptnsbc_core.curves.trajectory import reference
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import MODE_FORMATION, MODE_LAND, Array
from ptnsbc_io.wire import Diagnostics, DiagnosticStatus, HeaderFields, Stamped
from ptnsbc_nodes.bridge.procedure.steps import OVER, Step
from ptnsbc_nodes.comm.announcements import DecidedSlots, Decision, LostProcess
from ptnsbc_nodes.comm.legs import Epochs, Leg
from ptnsbc_sim.scenario import Scenario, scenario_from_text
from ptnsbc_sim.scenario.constants import leader_trajectory
from ptnsbc_sim.scenario.mission.route import places_beside_leader
from ptnsbc_sim.scenario.slots import with_slots

SILENT_S = 2.0
"""A process whose last status is older than this is shown as silent."""
_KEPT_NS = 1_000_000_000
_SILENT_NS = 500_000_000
_STILL_M_S = 0.05
_LANDING = {step.value for step in (Step.APART, Step.LAND, Step.DISARM, *OVER)}
_READY_LEVEL, _SILENT_LEVEL = 1, 2  # as on /diagnostics: WARN, ERROR


class FlightState:
    """Takes in what the processes of one fleet publish; `frame` is the picture of an instant."""

    def __init__(self, scenario: Scenario, clock_s: Callable[[], float]) -> None:
        """`clock_s`: steady, for the age of messages."""
        self.scenario = scenario  # as it is flown: with the slots that the UAVs took, once known
        self.flown_anew = 0  # how often `scenario` has changed
        self.processes = ProcessReports(clock_s)
        self.decided = DecidedSlots(scenario)
        self.epochs = Epochs(scenario)
        self._file = scenario
        self._clock_s = clock_s
        self._states = RecentStates()
        self._moving = scenario.formation.moves
        self._pace = _Pace()

    def on_odometry(self, uav: int, message: Stamped) -> None:
        """The state of one vehicle."""
        self._states.add(uav, message)
        self._pace.add(message.stamp_ns, self._clock_s())

    def on_leg(self, leg: HeaderFields) -> None:
        """A leg was announced."""
        self.epochs.announce(leg.stamp_ns, leg.frame_id)
        flown = self.epochs.scenario
        if flown is not self._file and not flown.formation.has_open_slots:
            self._file = flown  # a word on a leg of the mission
            self.scenario = flown
            self.flown_anew += 1

    def on_taken(self, setpoint: Stamped) -> None:
        """The leader follows a setpoint."""
        self.epochs.take(setpoint)
        self.scenario = self.epochs.scenario

    def on_slots(self, decision: Decision) -> None:
        """The UAVs have taken their slots."""
        self.decided.keep(decision)
        flown = with_slots(self._file, decision.slots)
        if flown.topology != self.scenario.topology:
            self.scenario = flown
            self.flown_anew += 1

    @property
    def leg(self) -> Leg | None:
        """The leg in force."""
        return self.epochs.at(self.stamp_ns)

    @property
    def stamp_ns(self) -> int:
        """The instant that is shown, of which the states of all vehicles are known; -1 before the first."""
        return self._states.common_ns

    def frame(self) -> dict[str, Any]:
        """The picture of this instant, as plain data: times [s], lengths [m]; None for what is not known.

        `t` counts from the first epoch, `left_s` to the deadline of the leg.
        """
        leg = self.leg
        t = since_s = left_s = None
        if leg is not None:
            t = seconds(self.stamp_ns - leg.first_t0_ns)
            since_s = seconds(self.stamp_ns - leg.t0_ns)
            if leg.mode == MODE_FORMATION:
                left_s = float(self.scenario.gains.formation.deadline_s) - since_s
        states = self._states.at(self.stamp_ns)
        places = {uav: state[:3] for uav, state in states.items()}
        # Vehicles may land without the leader's word: by the operator's order, or because the formation is given up.
        landing = leg is not None and (leg.mode == MODE_LAND or self.processes.all_land)
        self.processes.landing, left_s = landing, None if landing else left_s
        # Where UAVs hold or land nobody has a place in the formation.
        goals = self._goals(places, t) if left_s is not None else {}
        return {
            "t": _rounded(t),
            "leg": "waiting" if leg is None else "land" if landing else leg.name,
            "landing": self._landing(states) if landing else "",
            "since_s": _rounded(since_s),
            "left_s": _rounded(left_s),
            "pace": _rounded(self._pace.rate(self._clock_s())),
            "over": self.processes.over,
            "uavs": [
                self._uav(uav, states.get(uav), places, goals, t) for uav in self.scenario.uav_ids
            ],
            "processes": self.processes.levels(),
        }

    def _landing(self, states: Mapping[int, Array]) -> str:
        """The landing in a few words: the highest UAV, and how many still descend."""
        highest_m = max((float(state[2]) for state in states.values()), default=0.0)
        descend = sum(float(np.linalg.norm(state[7:10])) > _STILL_M_S for state in states.values())
        return f"landing, {highest_m:.1f} m, {descend} of {len(states)}"

    def _goals(self, places: dict[int, Array], t: float | None) -> dict[int, Array]:
        """The wanted place of each UAV (3,) [m]; without the followers while the leader is not heard."""
        scenario, instant = self.scenario, max(t or 0.0, 0.0)
        goals: dict[int, Array] = {}
        leader = places.get(scenario.leader.id)
        if t is not None:
            path = reference(leader_trajectory(scenario), instant).position
            goals[scenario.leader.id] = np.array(path)
        if leader is None:
            return goals
        for uav in scenario.uav_ids:
            if uav != scenario.leader.id:
                [beside] = places_beside_leader(scenario, uav, np.array([instant]))
                goals[uav] = leader + beside
        return goals

    def _uav(
        self,
        uav: int,
        state: Array | None,
        places: dict[int, Array],
        goals: dict[int, Array],
        t: float | None,
    ) -> dict[str, Any]:
        found: dict[str, Any] = {"id": uav, **self.processes.of_uav(uav)}
        if state is None:
            return found | {"pose": None, "speed": None, "error": None, "near": None}
        error = float(np.linalg.norm(places[uav] - goals[uav])) if uav in goals else None
        leader = places.get(self.scenario.leader.id)
        if self._moving and leader is not None and uav in goals:
            found["beside"] = np.round(goals[uav] - leader, 4).tolist()
        return found | {
            "pose": [round(float(number), 4) for number in state[:7]],
            "speed": _rounded(float(np.linalg.norm(state[7:10]))),
            "error": _rounded(error),
            "near": self._nearest(uav, places, -1.0 if t is None else t),
        }

    def _nearest(self, uav: int, places: dict[int, Array], t: float) -> dict[str, Any] | None:
        """The object that leaves the least room: its name, the distance, and the room above the keep-out."""
        own, scenario, at = places[uav], self.scenario, np.array([t])
        things = [
            *(
                (
                    f"UAV {i}",
                    float(np.linalg.norm((own - place) * scenario.formation.keep_out_scale)),
                    scenario.keep_out_between(uav, i),
                )
                for i, place in places.items()
                if i != uav
            ),
            *(
                (one.name, float(one.distances(own[None], at)[0]), one.keep_out_m)
                for one in scenario.world.bodies
            ),
        ]
        rooms = [
            (distance - limit, distance, name)
            for name, distance, limit in things
            if math.isfinite(distance)
        ]
        if not rooms:
            return None
        room, distance, name = min(rooms)
        return {"name": name, "distance": _rounded(distance), "room": _rounded(room)}


class ProcessReports:
    """Reports of the processes of a fleet, and who of them has ended."""

    def __init__(self, clock_s: Callable[[], float]) -> None:
        self.over = False  # the launcher has ended the flight
        self.landing = False  # who has landed ends
        self._clock_s = clock_s
        self._heard: dict[str, dict[str, tuple[float, DiagnosticStatus]]] = {}  # by process, name
        self._lost: set[str] = set()

    def on_status(self, array: Diagnostics) -> None:
        """Processes report about themselves."""
        now_s = self._clock_s()
        for status in array.statuses:
            process = status.name.partition(":")[0]
            self._heard.setdefault(process, {})[status.name] = (now_s, status)

    def on_lost(self, process: LostProcess) -> None:
        """A process has ended before its time."""
        self._lost.add(process.name)

    def of_uav(self, uav: int) -> dict[str, Any]:
        """The reports of the processes of one UAV: mode, vehicle, battery, fix, readiness."""
        planner, bridge = (
            [status for _, status in self._heard.get(f"{kind}{uav}", {}).values()]
            for kind in ("uav", "bridge")
        )
        vehicle = next((s.values for s in bridge if "armed" in s.values), {})
        battery = vehicle.get("battery_percent", "")
        return {
            "lost": f"uav{uav}" in self._lost and not self.landing,
            "mode": next((s.values["mode"] for s in planner if "mode" in s.values), None),
            "label": vehicle.get("label", ""),
            "vehicle": vehicle.get("mode") or None,
            "step": vehicle.get("step") or None,
            "armed": vehicle["armed"] == "true" if vehicle else None,
            "battery": int(battery) if battery.isdecimal() and len(battery) < 4 else None,
            "order": vehicle.get("order") or None,
            "fix": vehicle.get("fix") or None,
            "readiness": _readiness(bridge or planner),
        }

    @property
    def all_land(self) -> bool:
        """True if all vehicles land, or have landed, by the word of their bridges."""
        heard = (of for name, of in self._heard.items() if name.startswith("bridge"))
        steps = [s.values["step"] for of in heard for _, s in of.values() if "step" in s.values]
        return bool(steps) and all(step in _LANDING for step in steps)

    def levels(self) -> list[dict[str, Any]]:
        """Level and word of every process that has reported or ended; 0 is well, 1 a warning, 2 an error."""
        # uav2 before uav10
        names = sorted(
            self._heard.keys() | self._lost,
            key=lambda name: (name.rstrip("0123456789"), len(name), name),
        )
        return [{"name": name, **self._level(name)} for name in names]

    def _level(self, name: str) -> dict[str, Any]:
        if name in self._lost:
            level = 0 if self.landing else _SILENT_LEVEL
            return {"level": level, "word": "has ended", "silent": True}
        reports = self._heard[name].values()
        newest_s, status = max(reports, key=lambda report: (report[0], report[1].level))
        silent_s = self._clock_s() - newest_s
        if silent_s > SILENT_S and not self.over:
            return {"level": _SILENT_LEVEL, "word": f"silent for {silent_s:.0f} s", "silent": True}
        if status.values.get("ready") == "false":
            waits = status.values.get("waiting_for", "")
            level = max(status.level, _READY_LEVEL)
            return {"level": level, "word": f"waits for {waits}", "silent": False}
        return {"level": status.level, "word": status.message or "ready", "silent": False}


class RecentStates:
    """Odometry of each vehicle during the last second that it told.

    Messages of one instant arrive one after the other. Distances between the newest positions would therefore be
    wrong by the way of a vehicle between two messages, millimetres to centimetres.
    """

    def __init__(self) -> None:
        self._of: dict[int, deque[Stamped]] = {}

    def add(self, uav: int, message: Stamped) -> None:
        """Keep a state; one that was overtaken is dropped, and one from long before begins anew."""
        kept = self._of.setdefault(uav, deque())
        if kept and message.stamp_ns < kept[-1].stamp_ns - _KEPT_NS:
            kept.clear()
        if kept and message.stamp_ns <= kept[-1].stamp_ns:
            return
        kept.append(message)
        while kept[0].stamp_ns < message.stamp_ns - _KEPT_NS:
            kept.popleft()

    @property
    def common_ns(self) -> int:
        """The newest instant that every vehicle has reached, without those silent for 0.5 s; -1 before the first."""
        newest = [kept[-1].stamp_ns for kept in self._of.values()]
        last = max(newest, default=-1)
        return min((stamp for stamp in newest if stamp >= last - _SILENT_NS), default=-1)

    def at(self, stamp_ns: int) -> dict[int, Array]:
        """The odometry vectors (13,) of all vehicles at an instant, positions interpolated.

        A vehicle that has nothing before it or after it is where it told that it was.
        """
        states: dict[int, Array] = {}
        for uav, kept in self._of.items():
            after = next((one for one in kept if one.stamp_ns >= stamp_ns), kept[-1])
            before = next((one for one in reversed(kept) if one.stamp_ns <= stamp_ns), kept[0])
            states[uav] = after.values
            if before.stamp_ns < after.stamp_ns:
                share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
                states[uav] = after.values.copy()
                states[uav][:3] = before.values[:3] + share * (after.values[:3] - before.values[:3])
        return states


class _Pace:
    """Flight time per wall time, over the last second or so."""

    def __init__(self) -> None:
        self._from: tuple[int, float] | None = None
        self._rate: float | None = None

    def add(self, stamp_ns: int, now_s: float) -> None:
        if self._from is None or stamp_ns < self._from[0]:
            self._from = (stamp_ns, now_s)
        elif now_s - self._from[1] >= 1.0:
            self._rate = seconds(stamp_ns - self._from[0]) / (now_s - self._from[1])
            self._from = (stamp_ns, now_s)

    def rate(self, now_s: float) -> float | None:
        """None before it is known, 0 when nothing has come for a while."""
        stands = self._from is not None and now_s - self._from[1] > SILENT_S
        return 0.0 if stands else self._rate


def _readiness(statuses: Iterable[DiagnosticStatus]) -> str | None:
    """The fault of a process, or what it waits for, or the step that it is at; None of one that was not heard."""
    word = None
    for status in statuses:
        values = status.values
        if values.get("fault"):
            return values["fault"]
        if values.get("ready") == "false":
            return values.get("waiting_for") or "not ready"
        word = values.get("step") or word or "ready"
    return word


def _rounded(number: float | None) -> float | None:
    return round(number, 4) if number is not None and math.isfinite(number) else None


def scenario_of(text: str) -> Scenario:
    """The scenario that a UAV flies, from the text that it tells."""
    if not text:
        raise PtnsbcError("the UAV tells no scenario: expected one: ptnsbc view SCENARIO")
    # It comes over the network: it names no other file, and nothing of it is executed.
    return scenario_from_text(text, source="uav", complete=True)
