"""Messages that are one word and a time (std_msgs/Header): legs, slots, ended processes, orders of the operator.

A message on /formation/slots belongs to the epoch of its stamp. Its text has a pair for each UAV, "1:1 2:5 3:2".
"""

from __future__ import annotations

import re
import time
from collections.abc import Collection
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.nanoseconds import seconds
from ptnsbc_core.types import LEGS
from ptnsbc_io.wire import HeaderFields, HeaderTemplate, WireError, decode_header
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.topics import RECORDER, SIM
from ptnsbc_nodes.emergency import RETURN, Order, parse_order
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.legs import number_of
from ptnsbc_sim.scenario.slots import Slots, SlotsError, require_slots

if TYPE_CHECKING:
    from ptnsbc_nodes.comm.endpoints import Endpoints

_PROCESS = re.compile(rf"(uav|bridge)([1-9][0-9]{{0,5}})|{RECORDER}|{SIM}", re.ASCII)
_SHOWN = 40
_PAIR = re.compile(r"[0-9]{1,3}:[0-9]{1,3}")
_MOST_DECISIONS = 256  # that are remembered
_PERMIT_S = 5.0
ARM_SERVICE = "arm"
"""Of the launcher, below /formation; all others are the leader's."""


class LostProcess(NamedTuple):
    """A process that has ended."""

    name: str  # "uav3"
    uav: int | None  # its number, for the process of a UAV's controller


def decode_leg(data: bytes) -> HeaderFields:
    """Epoch [ns] and name of a leg, or a word on a leg of the mission; WireError when no UAV can fly it."""
    leg = decode_header(data)
    if leg.frame_id not in LEGS and number_of(leg.frame_id) is None:
        raise WireError(f"leg {leg.frame_id[:_SHOWN]!r}: expected one of {', '.join(LEGS)}")
    if leg.stamp_ns < 0:
        raise WireError(f"leg {leg.frame_id}: epoch {leg.stamp_ns} ns: expected 0 or later")
    return leg


def decode_lost(data: bytes) -> LostProcess:
    """The process that has ended; WireError for a name that no process has."""
    name = decode_header(data).frame_id
    process = _PROCESS.fullmatch(name)
    if process is None:
        raise WireError(f"process {name[:_SHOWN]!r}: expected uavN, bridgeN, {SIM} or {RECORDER}")
    return LostProcess(name, int(process[2]) if process[1] == "uav" else None)


class Requests:
    """Permission of an operator to call services of this node.

    A service carries no seal: in a sealed fleet a sealed message on /formation/request permits one call.
    """

    def __init__(self, endpoints: Endpoints, names: Collection[str], *, signed: bool) -> None:
        """`names`: of the services of this node and of others that operators call."""
        self._signed = signed
        self._requested_s: dict[str, float] = {}  # when each was last requested

        def decode(data: bytes) -> str:
            name = decode_header(data).frame_id
            if name not in names:
                raise WireError(f"request {name[:_SHOWN]!r}: expected one of {', '.join(names)}")
            return name

        def take(name: str) -> None:
            self._requested_s[name] = time.monotonic()

        endpoints.listen(topics.REQUEST, decode, take, required=False)

    def refusal(self, name: str) -> str | None:
        """The reason why a service must not answer; None when it may, and its permission is used up."""
        requested_s = self._requested_s.pop(name, float("-inf"))
        if not self._signed or time.monotonic() - requested_s < _PERMIT_S:
            return None
        return f"security: signed: expected a sealed {topics.REQUEST.name} before the call"


def decode_order(data: bytes) -> Order:
    """An order of the operator, or of a bridge that gives the formation up; WireError for any other words."""
    text = decode_header(data).frame_id
    order = parse_order(text)
    if order is None or order.what == RETURN:  # that is for one vehicle
        raise WireError(
            f"order {text[:_SHOWN]!r}: expected land, kill, land all, kill all or apart"
        )
    return order


class Decision(NamedTuple):
    """The slot of every UAV from an epoch on."""

    t0_ns: int  # of the epoch
    slots: Slots


def encode_slots(decision: Decision) -> bytes:
    """std_msgs/Header of a decision."""
    text = " ".join(f"{uav}:{slot}" for uav, slot in decision.slots.items())
    return HeaderTemplate(text).encode(decision.t0_ns)


def decode_slots(data: bytes, scenario: Scenario) -> Decision:
    """The decision in a message; SlotsError when it does not give every UAV of the scenario a slot of its own."""
    t0_ns, text = decode_header(data)
    slots: dict[int, int] = {}
    for pair in text.split():
        if not _PAIR.fullmatch(pair):
            raise SlotsError(f"slots {pair[:20]!r}: expected a pair UAV:SLOT")
        uav, slot = map(int, pair.split(":"))
        if uav in slots:
            raise SlotsError(f"slots {pair!r}: expected each UAV once")
        slots[uav] = slot
    require_slots(scenario, slots)
    return Decision(t0_ns, slots)


class DecidedSlots:
    """The decisions that have been heard, by epoch. The first one for an epoch counts."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._by_epoch: dict[int, Slots] = {}

    def decode(self, data: bytes) -> Decision:
        """As `decode_slots`; SlotsError also for a decision that contradicts the one for its epoch."""
        decision = decode_slots(data, self._scenario)
        if self._by_epoch.get(decision.t0_ns, decision.slots) != decision.slots:
            epoch_s = seconds(decision.t0_ns)
            raise SlotsError(f"second slots of the epoch at {epoch_s:.3f} s: the first ones count")
        return decision

    def keep(self, decision: Decision) -> None:
        """Take a decision; one that the latched topic repeats changes nothing."""
        self._by_epoch.setdefault(decision.t0_ns, decision.slots)
        while len(self._by_epoch) > _MOST_DECISIONS:
            del self._by_epoch[next(iter(self._by_epoch))]

    def of(self, t0_ns: int) -> Slots | None:
        """The slots of an epoch [ns]; None while they have not been heard."""
        return self._by_epoch.get(t0_ns)


def keep_recorded(decided: DecidedSlots, data: bytes) -> None:
    """Take a recorded message as the UAVs did: one that is no decision is forgotten."""
    with suppress(PtnsbcError):
        decided.keep(decided.decode(data))
