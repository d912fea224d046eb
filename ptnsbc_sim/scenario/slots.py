"""Assignment of the UAVs to the slots of the formation.

A slot is a place of the formation with all that belongs to it: its offset from the leader, its parent, its links and
its task. It has the number of the UAV to which the scenario gives it. With `formation.assignment: optimal` the UAVs
take the slots so that the sum of the squared distances to them is minimal. Mass, noise, ports and keep-out stay with
the UAV. docs/method.md, "Slots", proves what follows from the minimum.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.topology import Topology, estimator_matrix
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario.build import places_beside_leader
from ptnsbc_sim.scenario.fields import Block
from ptnsbc_sim.scenario.mission.shapes import Change, nearest_places
from ptnsbc_sim.scenario.model import ScenarioFile
from ptnsbc_sim.scenario.scenario import Scenario

Slots = Mapping[int, int]
"""Slot of every UAV."""


class SlotsError(PtnsbcError):
    """An assignment of slots that no fleet can fly."""


def are_open(scenario: Scenario) -> bool:
    """True if it is open who takes which slot, until an epoch decides it."""
    return scenario.formation.assignment == "optimal"


def optimal_slots(
    scenario: Scenario, positions: Mapping[int, Array], t: float = 0.0
) -> dict[int, int]:
    """The slots for which the sum of the squared distances from the positions to them is minimal.

    Args:
        scenario: the UAVs and their offsets.
        positions: (3,) [m], ENU, of every UAV at one instant.
        t: that instant, in seconds since the first epoch; the places of a shape that moves depend on it.

    Raises:
        SlotsError: the position of a UAV is missing or not finite.
    """
    ids = scenario.uav_ids
    for uav in ids:
        if uav not in positions or not np.isfinite(positions[uav]).all():
            raise SlotsError(f"slots: no finite position of UAV {uav}: expected one of every UAV")
    starts = np.stack([positions[uav] for uav in ids])
    places = np.concatenate([places_beside_leader(scenario, uav, np.array([t])) for uav in ids])
    order = nearest_places(starts, places, centred=True)
    return {uav: ids[int(row)] for uav, row in zip(ids, order, strict=True)}


def require_slots(scenario: Scenario, slots: Slots) -> None:
    """Raise SlotsError unless `slots` gives every UAV a slot of its own."""
    ids = set(scenario.uav_ids)
    if set(slots) != ids:
        odd = ", ".join(map(str, sorted(ids.symmetric_difference(slots))))
        raise SlotsError(
            f"slots of {len(slots)} UAVs: expected those of {len(ids)}; look at UAV {odd}"
        )
    if set(slots.values()) != ids:
        odd = ", ".join(map(str, sorted(ids.symmetric_difference(slots.values()))))
        raise SlotsError(
            f"slots: no UAV or more than one takes slot {odd}: expected one UAV for each"
        )


def with_slots(scenario: Scenario, slots: Slots) -> Scenario:
    """The scenario in which every UAV has the offset, the links and the task of its slot.

    Its `text` stays that of the whole flight: a later epoch may decide anew.

    Raises:
        SlotsError: not every UAV has a slot of its own.
    """
    require_slots(scenario, slots)
    holder = {slot: uav for uav, slot in slots.items()}
    if all(uav == slot for uav, slot in slots.items()):
        return scenario
    topology = _topology_of(scenario.topology, holder)
    return scenario.model_copy(update={**_blocks_of(scenario, holder), "topology": topology})


def with_slots_of_starts(scenario: Scenario) -> Scenario:
    """The scenario with the slots of its starts; as it is, where every UAV has its own."""
    if not are_open(scenario):
        return scenario
    starts = {uav: scenario.uav(uav).position for uav in scenario.uav_ids}
    return with_slots(scenario, optimal_slots(scenario, starts))


def _blocks_of(file: ScenarioFile, holder: Mapping[int, int]) -> dict[str, Block]:
    """The blocks of a file in which each UAV holds the slot of another one."""
    links, formation = file.communication, file.formation
    links = links.model_copy(
        update={
            "tree": {holder[child]: holder[above] for child, above in links.tree.items()},
            "leader_links": tuple(holder[slot] for slot in links.leader_links),
            "estimator_edges": tuple((holder[a], holder[b]) for a, b in links.estimator_edges),
        }
    )
    formation = formation.model_copy(
        update={
            "offsets_m": {holder[k]: at for k, at in formation.offsets_m.items()},
            "changes": tuple(_change_of(change, holder) for change in formation.changes),
        }
    )
    leader = file.leader.model_copy(update={"id": holder[file.leader.id]})
    return {"communication": links, "leader": leader, "formation": formation}


def _change_of(change: Change, holder: Mapping[int, int]) -> Change:
    if change.offsets_m is None:
        return change
    return change.model_copy(
        update={"offsets_m": {holder[k]: at for k, at in change.offsets_m.items()}}
    )


def _topology_of(topology: Topology, holder: Mapping[int, int]) -> Topology:
    """The same graph on other UAVs; its eigenvalues stay, to the last bit."""
    leader = holder[topology.leader]
    pinned = frozenset(holder[slot] for slot in topology.pinned)
    neighbours = {
        holder[slot]: tuple(sorted(holder[other] for other in others))
        for slot, others in topology.neighbours.items()
    }
    followers = [uav for uav in topology.order if uav != leader]
    return topology._replace(
        leader=leader,
        parent={holder[child]: holder[above] for child, above in topology.parent.items()},
        pinned=pinned,
        neighbours=neighbours,
        matrix=estimator_matrix(followers, pinned, neighbours),
        depth={holder[slot]: hops for slot, hops in topology.depth.items()},
    )
