"""Faults that a scenario injects: what, whose, when and for how long. Sorted by what they strike.

A fault begins at a mission time, counted from the first epoch. The tables of this module say which keys a kind takes,
and where it can be injected; the checks and the documentation read them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from ptnsbc_core.nanoseconds import nanoseconds
from ptnsbc_sim.scenario.fields import Block, NotNegative, Number, Positive, UavId, Vec3
from ptnsbc_sim.scenario.problems import Problems, one_of, unless

FaultKind = Literal[
    "silence",
    "loss",
    "delay",
    "nan",
    "jump",
    "kill",
    "freeze",
    "restart",
    "clock_offset",
    "disk_full",
]
MOST_DELAY_S = 1.0
"""Largest `delay_s` of a fault."""
NEVER_NS = 2**62
"""Later than any flight."""

_RESTART_NS = 2_000_000_000
"""Time that a process takes to start [ns]: so long is a UAV gone that is restarted at once."""

MESSAGES, POSITION, PROCESS, RECORDER = "messages", "position", "process", "recorder"


class FaultRule(NamedTuple):
    """The target of a kind of fault, and the keys that it takes."""

    strikes: str
    what: str
    needs: str = ""  # key of its amount
    lasts: bool = True  # whether it takes `duration_s`
    headless: bool = False  # whether a headless flight models it
    lockstep: bool = True  # whether a fleet in lock-step can inject it


FAULTS: Mapping[str, FaultRule] = {
    "silence": FaultRule(MESSAGES, "no message of the UAV reaches another UAV", headless=True),
    "loss": FaultRule(
        MESSAGES, "a share of the messages of the UAV gets lost", "share", headless=True
    ),
    "delay": FaultRule(MESSAGES, "the messages of the UAV come late", "delay_s", headless=True),
    "nan": FaultRule(
        MESSAGES, "the UAV sends states that are no numbers; receivers refuse them", headless=True
    ),
    "jump": FaultRule(
        POSITION, "the UAV measures its position with an offset", "offset_m", headless=True
    ),
    "kill": FaultRule(
        PROCESS, "SIGKILL; the vehicle of a UAV stays in place", lasts=False, headless=True
    ),
    "freeze": FaultRule(PROCESS, "SIGSTOP, and SIGCONT after the duration", lockstep=False),
    "restart": FaultRule(
        PROCESS,
        "SIGKILL; the launcher starts the process again, after the duration or at once",
        headless=True,
    ),
    "clock_offset": FaultRule(
        MESSAGES, "the stamps of the UAV's messages are shifted", "offset_s", lockstep=False
    ),
    "disk_full": FaultRule(
        RECORDER, "the recorder cannot write any more", lasts=False, lockstep=False
    ),
}
"""The effect of each kind of fault, and the keys that it takes."""

_AMOUNTS = tuple(rule.needs for rule in FAULTS.values() if rule.needs)
_OF_UAV = re.compile(r"(?:uav|bridge)(\d+)")


ProcessName = Annotated[str, Field(pattern=r"^((uav|bridge)[1-9]\d{0,2}|sim|recorder)$")]


class FaultBlock(Block):
    """A fault and its victim."""

    kind: FaultKind
    """Kind of the fault, see [faults.md](faults.md#injection)."""
    at_s: NotNegative
    """Mission time at which it begins, counted from the first epoch."""
    uav: UavId | None = None
    """Id of the UAV that it strikes."""
    process: ProcessName | None = None
    """`kill`, `freeze`, `restart`: the process, if it is not that of `uav`."""
    duration_s: Positive | None = None
    """Duration. Default: to the end of the flight."""
    share: Annotated[Number, Field(gt=0, lt=1)] | None = None
    """`loss`: fraction of the messages that is lost."""
    delay_s: Annotated[Positive, Field(le=MOST_DELAY_S)] | None = None
    """`delay`: what is added to the time from sending to arrival."""
    offset_m: Vec3 | None = None
    """`jump`: offset of the measured position, ENU."""
    offset_s: Annotated[Number, Field(ge=-60, le=60)] | None = None
    """`clock_offset`: what is added to the stamps."""

    @property
    def rule(self) -> FaultRule:
        """The rule of the kind."""
        return FAULTS[self.kind]

    @property
    def victim(self) -> str:
        """Name of the process that it strikes, `uav3`."""
        if self.process is not None:
            return self.process
        return "recorder" if self.uav is None else f"uav{self.uav}"

    @property
    def struck_uav(self) -> int | None:
        """Id of the UAV that it strikes; None when that is another process."""
        name = self.victim
        return int(name.removeprefix("uav")) if name.startswith("uav") else None

    @property
    def text(self) -> str:
        """In words, for people."""
        amount = getattr(self, self.rule.needs) if self.rule.needs else None
        shown = "" if amount is None else f" {self.rule.needs} {amount}"
        lasts = f" for {self.duration_s:g} s" if self.duration_s is not None else ""
        return f"{self.kind} of {self.victim}{shown} at {self.at_s:g} s{lasts}"

    def window_ns(self, t0_ns: int) -> tuple[int, int]:
        """First instant [ns], and the first after it; `t0_ns` is the first epoch."""
        start_ns = t0_ns + nanoseconds(self.at_s)
        if self.kind == "restart" and self.duration_s is None:
            return start_ns, start_ns + _RESTART_NS
        if self.duration_s is None:
            return start_ns, NEVER_NS
        return start_ns, start_ns + nanoseconds(self.duration_s)


def modelled(faults: Sequence[FaultBlock]) -> tuple[FaultBlock, ...]:
    """The faults that a headless flight injects."""
    return tuple(
        fault
        for fault in faults
        if fault.rule.headless and (fault.rule.strikes != PROCESS or fault.victim.startswith("uav"))
    )


def fault_problems(fault: FaultBlock, uavs: Collection[int]) -> Problems:
    """The problems of a fault among these UAVs."""
    rule, kind, uav, process = fault.rule, fault.kind, fault.uav, fault.process
    if rule.strikes == RECORDER:
        free = uav is None and process in (None, "recorder")
        yield from unless(free, "uav", f"{kind} strikes the recorder", "no UAV")
    elif rule.strikes == PROCESS:
        one = (uav is None) != (process is None)
        yield from unless(one, "uav", f"{kind} needs uav or process", "one of them")
    else:
        yield from unless(process is None, "process", f"{process}: {kind} strikes a UAV", "uav")
        victim = f"the id of the UAV that {kind} strikes"
        yield from unless(uav is not None, "uav", "missing", victim)
    of_uav = _OF_UAV.fullmatch(process or "")
    number = int(of_uav[1]) if of_uav else uav
    known = number is None or number in uavs
    yield from unless(known, "uav", f"{number}: no such UAV", one_of(uavs))
    for key in _AMOUNTS:
        given, needed = getattr(fault, key) is not None, key == rule.needs
        yield from unless(given or not needed, key, f"missing: {kind} needs it", "")
        yield from unless(needed or not given, key, f"{kind} does not take it: remove it", "")
    ends = rule.lasts or fault.duration_s is None
    yield from unless(ends, "duration_s", f"{kind} has no end: remove it", "")
    goes_on = kind != "freeze" or fault.duration_s is not None
    why = "missing: a process that is frozen must go on; use kill to end it"
    yield from unless(goes_on, "duration_s", why, "")
