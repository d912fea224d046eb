"""Faults of a scenario: what is injected where."""

from __future__ import annotations

from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.mission.faults import FaultBlock, modelled
from ptnsbc_tools.check.finding import INFO, WARNING, Finding, Findings


def faults(scenario: Scenario) -> Findings:
    """Faults that begin after the flight, and those that not every flight injects."""
    for index, fault in enumerate(scenario.faults or ()):
        key = f"faults[{index}]"
        if fault.at_s >= scenario.timing.duration_s:
            yield Finding(
                WARNING,
                f"{key}.at_s",
                f"{fault.at_s:g} s",
                f"< timing.duration_s, {scenario.timing.duration_s:g} s",
                "it never begins: lower at_s, or fly longer",
            )
        elif where := _where(scenario, fault):
            yield Finding(INFO, key, fault.text, "every flight injects it", where)


def _where(scenario: Scenario, fault: FaultBlock) -> str:
    """The place of a fault; empty when it is injected everywhere."""
    return "" if fault in modelled(scenario.faults) else "only in real time"
