"""The table of `docs/faults.md`."""

from __future__ import annotations

from docs.make.markdown import table
from ptnsbc_sim.scenario.mission.faults import FAULTS, FaultRule

_HEADINGS = ("Kind", "What happens", "Needs", "Takes `duration_s`", "Headless", "Lock-step")


def regions() -> dict[str, str]:
    """Every made region of the page."""
    return {"kinds": table(_HEADINGS, (_cells(kind, rule) for kind, rule in FAULTS.items()))}


def _cells(kind: str, rule: FaultRule) -> tuple[str, ...]:
    needs = f"`{rule.needs}`" if rule.needs else ""
    marks = ("yes" if flag else "no" for flag in (rule.lasts, rule.headless, rule.lockstep))
    return f"`{kind}`", rule.what, needs, *marks
