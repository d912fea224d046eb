"""The process of one bridge: it makes the node and its link, and serves them until their end."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.launcher import launcher_ended
from ptnsbc_nodes.runtime.node_process import ProcessLifetime, options_of, ros_context, ros_node
from ptnsbc_sim.scenario import Scenario

if TYPE_CHECKING:
    from ptnsbc_nodes.bridge.bridge_node import BridgeNode

_NO_REAL_TIME = (
    "bridge: no right to real-time scheduling: a busy host may delay setpoints "
    "(ulimit -r above 0 grants it)"
)


class BridgeError(PtnsbcError):
    """A bridge that cannot be opened."""


class _LandingLifetime(ProcessLifetime):
    """The first request to end lands the vehicle; the second one ends the process."""

    def __init__(self) -> None:
        super().__init__()
        self.bridge: BridgeNode | None = None
        self._requested = self._orphaned = False

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        before, self._orphaned = self._orphaned, launcher_ended()
        # The end of the launcher is nobody's second request.
        by_kernel = self._orphaned and not before
        repeated, self._requested = self._requested and not by_kernel, True
        if repeated or self.bridge is None or not self.bridge.land():
            super()._on_signal(number, frame)
            return
        print("bridge: landing; interrupt once more to end at once", file=sys.stderr, flush=True)


def serve_bridge(
    scenario: Scenario,
    uav: int,
    argv: Sequence[str],
    *,
    recorded: bool = False,
    signing_key: Path | None = None,
    allow_arming: bool = False,
    with_fleet: bool = False,
) -> int:
    """Bridge one vehicle until it has landed, or a signal; returns the exit code.

    `argv` is for ROS, `signing_key` the key file instead of the scenario's.

    Raises:
        PtnsbcError: the vehicle cannot be bridged.
    """
    lifetime = _LandingLifetime()
    try:
        from ptnsbc_nodes.bridge.bridge import open_link
        from ptnsbc_nodes.bridge.bridge_node import BridgeNode, BridgeOptions
        from ptnsbc_nodes.bridge.ros_vehicle.topics import open_ros_link
    except ImportError as error:
        raise BridgeError(f"{error.name} is not installed: install the extra [mavlink]") from None
    if scenario.plant.kind != "quadrotor":
        raise BridgeError(
            f"{scenario.source}: plant.kind: {scenario.plant.kind}: expected quadrotor, the only plant that flight "
            "controllers fly here"
        )
    settings = scenario.vehicle_link(scenario.uav(uav).id)
    key = str(signing_key or settings.signing_key or "")
    edges = CommunicationGraph(scenario, options_of(scenario, recorded=recorded, bridged=True))
    with ros_context(argv), ros_node("bridge", f"/uav{uav}", scenario) as node:
        if not environment.prefer_punctuality():
            print(_NO_REAL_TIME, file=sys.stderr, flush=True)
        link = open_ros_link(node, scenario, uav) or open_link(settings, key, lambda: lifetime.over)
        options = BridgeOptions(allow_arming, with_fleet, key)
        bridge = BridgeNode(node, scenario, uav, edges, link, options, lifetime.end)
        lifetime.bridge = bridge
        bridge.start()
        lifetime.serve([node], lambda: [bridge.endpoints])
        bridge.close()
    return bridge.exit_code
