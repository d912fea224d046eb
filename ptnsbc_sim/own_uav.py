"""The functions of the user that one UAV flies by: law, task and controller."""

from __future__ import annotations

from typing import NamedTuple

from ptnsbc_sim.law import LoadedLaw, UavLaw
from ptnsbc_sim.own_controller import OwnController, load_controller
from ptnsbc_sim.own_task import OwnTask, load_task
from ptnsbc_sim.scenario import Scenario


class UavFunctions(NamedTuple):
    """Functions of the user; None: ours."""

    law: UavLaw | None = None
    task: OwnTask | None = None
    controller: OwnController | None = None

    @classmethod
    def of(cls, scenario: Scenario, uav: int, law: LoadedLaw | None = None) -> UavFunctions:
        """The functions that a scenario names for a UAV: the leader has neither law nor task.

        Args:
            scenario: what is flown.
            uav: id.
            law: the law, where the scenario comes from a bag, which does not carry it.

        Raises:
            UserFileError: a function cannot be loaded.
            ScenarioError: the scenario comes from a bag and names one.
        """
        named, follows = scenario.plugins, uav != scenario.leader_id
        own_law = None
        if follows and law is not None:
            own_law = UavLaw(law, scenario, uav)
        elif follows and scenario.law is not None:
            own_law = UavLaw.of(scenario, uav)
        by_task = follows and named.task is not None
        return cls(
            own_law,
            load_task(named.path_of("task")) if by_task else None,
            load_controller(named.path_of("controller")) if named.controller else None,
        )


OURS = UavFunctions()
"""A UAV without functions of the user."""
