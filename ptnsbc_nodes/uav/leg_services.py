"""The operator's services on the leader: /formation/{start,hold,land,stop} announce a leg.

With a mission there are /formation/leg_N, which begins leg N, /formation/cancel, and /formation/mission, which answers
with the legs as JSON. Before the first epoch leg_N starts the flight: the formation comes about, and leg N follows.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from functools import partial
from itertools import zip_longest
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import nanoseconds, seconds
from ptnsbc_core.types import MODE_FORMATION
from ptnsbc_io.wire import HeaderFields, HeaderTemplate
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.announcements import ARM_SERVICE, Requests
from ptnsbc_nodes.comm.endpoints import Endpoints
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.comm.legs import FIRST_LEG
from ptnsbc_nodes.comm.topics import LAUNCHER
from ptnsbc_nodes.runtime.launcher import PARENT
from ptnsbc_nodes.uav.clocks import LEAD_NS, UavClock
from ptnsbc_nodes.uav.uav_controller import UavController, UavFlight
from ptnsbc_sim.scenario.approach.deadline import leg_room
from ptnsbc_sim.scenario.mission.legs import (
    CANCEL,
    ScheduledLeg,
    Word,
    formed_s,
    leg_names,
    utc_time,
    word_text,
)

_MOST_WAIT_S = 3600.0  # for the start of a mission

_LEGS = {"start": FIRST_LEG, "hold": "hold", "land": "land", "stop": "land"}


CANCEL_SERVICE, LIST_SERVICE = "cancel", "mission"


def leg_service(number: int) -> str:
    """Name of the service that begins a leg of the mission."""
    return f"leg_{number}"


class LegServices:
    """Answers the services of the leader, while `serve` holds. A successor of the leader serves when it leads.

    In lock-step the first epoch is 0, where simulated time starts. Every other leg begins after
    `LEAD_NS`, but a stop in real time begins at once.
    """

    def __init__(
        self,
        node: Node,
        endpoints: Endpoints,
        edges: CommunicationGraph,
        flight: UavFlight,
        clock: UavClock,
        waiting_for: Callable[[], Sequence[str]],
    ) -> None:
        """`waiting_for`: empty when the leader is ready to start."""
        self._node, self._endpoints, self._flight = node, endpoints, flight
        self._clock, self._waiting_for = clock, waiting_for
        self._listeners = dict.fromkeys(flight.scenario.uav_ids, 1 + edges.options.bridged)
        # A launcher listens for the first leg once all are ready.
        self._launched = edges.options.bridged and PARENT in os.environ
        leads = flight.uav == flight.scenario.leader.id
        self._publish = endpoints.publisher(
            topics.EPOCH, edges.readers(topics.EPOCH) if leads else 0
        )
        self._untold: list[HeaderFields] = []
        mission = flight.scenario.mission
        numbers = () if mission is None else range(2, len(mission.legs) + 1)
        self._words = {leg_service(number): number for number in numbers}
        if mission is not None:
            self._words[CANCEL_SERVICE] = CANCEL
        self._names = (*_LEGS, *self._words, *((LIST_SERVICE,) if self._words else ()))
        self._requests = Requests(
            endpoints, (*self._names, ARM_SERVICE), signed=edges.options.seal is not None
        )
        self._services: list[Any] = []

    def missing_listeners(self) -> list[str]:
        """UAVs that do not listen to the epoch yet; none for a UAV that does not serve."""
        if not self._services:
            return []
        return self._endpoints.unmatched(topics.EPOCH, self._listeners)

    def keep(self, leg: HeaderFields) -> None:
        """A leg, or a word on a leg of the mission, that another UAV has announced."""
        if not self._clock.lockstep:  # there no process starts in flight
            self._untold.append(leg)

    def serve(self) -> None:
        """Answer the services from now on, and announce again what another UAV has announced.

        The messages of a leader are latched as long as its process lives. A UAV that is started after that hears the
        legs from the successor; UAVs that know them leave them out.
        """
        for leg in self._untold:
            self._publish(HeaderTemplate(leg.frame_id).encode(leg.stamp_ns))
        self._untold.clear()
        if self._services:
            return
        self._services = [
            self._node.create_service(
                Trigger,
                f"{self._endpoints.fleet}/formation/{name}",
                partial(self._on_request, name),
            )
            for name in self._names
        ]

    def follow(self, controller: UavController) -> None:
        """Serve the operator while the UAV leads, where UAVs may come and go."""
        if self._flight.scenario.formation.reconfigures:
            (self.serve if controller.leads else self.close)()

    def close(self) -> None:
        """Remove the services from the node."""
        for service in self._services:
            self._node.destroy_service(service)
        self._services.clear()

    def _on_request(self, name: str, _request: Any, response: Any) -> Any:
        refusal = self._refusal(name)
        response.success = refusal is None
        if refusal is not None:
            response.message = refusal
        elif name == LIST_SERVICE:
            response.message = self._list()
        elif name in self._words:
            response.success, response.message = self._begin_leg(self._words[name])
        else:
            response.message = self._announce(name)
        return response

    def _start_ns(self) -> int | None:
        """The time at which the mission begins by the wall clock; None when it does not say so, and in lock-step."""
        mission = self._flight.scenario.mission
        if mission is None or mission.start is None or self._clock.lockstep:
            return None
        return utc_time(mission.start).next_ns(self._clock.now_ns() + LEAD_NS)

    def _refusal(self, name: str) -> str | None:
        if refused := self._requests.refusal(name):
            return refused
        announced, begins = self._flight.epochs.announced, self._words.get(name, CANCEL) != CANCEL
        starts = name == "start" or (begins and not announced)
        if not (announced or starts or name == LIST_SERVICE):
            return "not started: call /formation/start first"
        start_ns = self._start_ns()
        if starts and start_ns is not None and not announced:
            ahead_s = seconds(start_ns - self._clock.now_ns() - LEAD_NS)
            if not 0.0 <= ahead_s <= _MOST_WAIT_S:
                when = f"{ahead_s:.1f} s from now" if ahead_s > 0.0 else f"{-ahead_s:.1f} s ago"
                return f"mission.start: {when}: expected a time within the next {_MOST_WAIT_S:g} s"
        if starts and announced and self._words:
            return "begun already: expected another leg of the mission"
        if starts and self._launched and not self._endpoints.is_heard_by(topics.EPOCH, LAUNCHER):
            return "not all processes and vehicles are ready: the launcher names those that are not"
        missing = self._waiting_for() if starts else ()
        return f"the leader waits for {', '.join(missing)}" if missing else None

    def _list(self) -> str:
        """The legs of the mission as JSON, with the time since the first epoch."""
        scenario, now_ns = self._flight.epochs.scenario, self._clock.now_ns()
        flown = self._flight.epochs.at(now_ns)
        assert scenario.mission is not None  # or there is no service

        def row(number: int, name: str, kind: str, leg: ScheduledLeg | None) -> dict[str, Any]:
            keys = () if leg is None else ("begin_s", "due_s", "end_s")
            times = {key: getattr(leg, key) for key in keys}
            return {"number": number, "name": name, "kind": kind, **times}

        begun = {leg.number: leg for leg in scenario.legs}
        names = leg_names(scenario.mission)
        rows = [row(CANCEL, leg.name, "hold", leg) for leg in scenario.legs if leg.number == CANCEL]
        for number, block in enumerate(scenario.mission.legs, 1):
            rows.append(row(number, names[number - 1], block.kind, begun.get(number)))
        now_s = None if flown is None else seconds(now_ns - flown.first_t0_ns)
        return json.dumps({"now_s": now_s, "legs": rows})

    def _begin_leg(self, number: int) -> tuple[bool, str]:
        """Begin a leg of the mission, or cancel the present one: whether that can be flown, and a sentence."""
        epochs, now_ns = self._flight.epochs, self._clock.now_ns()
        scenario, leg, announced = epochs.scenario, epochs.at(now_ns), epochs.announced
        if announced and (leg is None or leg.mode != MODE_FORMATION):
            name = "no leg" if leg is None else f"leg {leg.name}"
            return False, f"{name} is flown: expected the formation, which flies the mission"
        first = None if announced else Word(number, formed_s(scenario.legs, number))
        word = first or epochs.word(now_ns + LEAD_NS, number)
        try:
            flown = scenario.with_words((*scenario.words, word))
        except PtnsbcError as error:
            return False, str(error)
        legs = [leg for leg in flown.legs if leg.begin_s >= word.at_s]  # from where it is by then
        for leg_flown, following in zip_longest(legs, legs[1:]):
            until_s = leg_flown.end_s if following is None else following.begin_s
            room = leg_room(flown, leg_flown, until_s)
            if room.advice:
                return False, f"leg {room.value}: expected {room.expected}; {room.advice}"
        if not announced:
            self._announce("start")
        text = word_text(number)
        t0_ns = (epochs.first_t0_ns or 0) + nanoseconds(word.at_s)
        if not epochs.announce(t0_ns, text):
            return False, "another leg was begun just now: try again"
        self._publish(HeaderTemplate(text).encode(t0_ns))
        begun = legs[0]
        return True, f"leg {begun.name} from {begun.begin_s:.2f} s, due at {begun.due_s:.2f} s"

    def _announce(self, name: str) -> str:
        first, leg = not self._flight.epochs.announced, _LEGS[name]
        t0_ns = self._start_ns() if first else None
        if t0_ns is None:
            t0_ns = self._clock.epoch_ns(first=first, at_once=name == "stop")
        if leg == FIRST_LEG and self._flight.decider is not None:
            self._flight.decider.decide(t0_ns)
        self._flight.epochs.announce(t0_ns, leg)
        self._publish(HeaderTemplate(leg).encode(t0_ns))
        return f"leg {leg} from {seconds(t0_ns):.3f} s"
