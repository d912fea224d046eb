"""The tables of `docs/faults.md`."""

from __future__ import annotations

from docs.make.fault_table import ANSWERS, FaultAnswer
from docs.make.markdown import table
from ptnsbc_sim.scenario.mission.fault_rules import FAULTS, FaultRule

_HEADINGS = ("Kind", "What happens", "Needs", "Takes `duration_s`", "Headless", "Lock-step")

_ANSWER = ("Fault", "In", "Detected by", "Within", "State", "Action", "Recovers", "Tests")


def regions() -> dict[str, str]:
    """Every made region of the page."""
    return {
        "kinds": table(_HEADINGS, (_cells(kind, rule) for kind, rule in FAULTS.items())),
        "answers": table(_ANSWER, (_answer(one) for one in ANSWERS)),
    }


def _cells(kind: str, rule: FaultRule) -> tuple[str, ...]:
    needs = f"`{rule.needs}`" if rule.needs else ""
    marks = ("yes" if flag else "no" for flag in (rule.lasts, rule.headless, rule.lockstep))
    return f"`{kind}`", rule.what, needs, *marks


def _answer(one: FaultAnswer) -> tuple[str, ...]:
    tests = ", ".join(f"`{test}`" for test in one.tests)
    where = ", ".join(one.where)
    how = one.detected_by, one.within, one.state, one.action, one.recovers
    return one.fault, where, *how, tests
