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
from ptnsbc_nodes.runtime.lifecycle_node import ManagedNode
from ptnsbc_nodes.runtime.node_process import (
    ProcessLifetime,
    options_of,
    ros_context,
    ros_node,
    serve_managed,
)
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
        self._requested = False

    def land_or_end(self) -> None:
        """Land a flying vehicle; end when none flies, or at the second request."""
        if not self._lands():
            self.end()

    def _lands(self) -> bool:
        repeated, self._requested = self._requested, True
        if repeated or self.bridge is None or not self.bridge.land():
            return False
        print("bridge: landing; interrupt once more to end at once", file=sys.stderr, flush=True)
        return True

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if not self._lands():
            super()._on_signal(number, frame)


def serve_bridge(
    scenario: Scenario,
    uav: int,
    argv: Sequence[str],
    *,
    recorded: bool = False,
    signing_key: Path | None = None,
    allow_arming: bool = False,
    managed: bool = False,
) -> int:
    """Bridge one vehicle until it has landed, or a signal; returns the exit code.

    `argv` is for ROS, `signing_key` the key file instead of the scenario's; a `managed` bridge waits to be configured.
    """
    lifetime = _LandingLifetime()
    settings = scenario.vehicle_link(scenario.uav(uav).id)
    key = str(signing_key or settings.signing_key or "")
    flight = options_of(scenario, recorded=recorded, bridged=True)
    with (
        ros_context(argv),
        ros_node("bridge", f"/uav{uav}", make=ManagedNode, scenario=scenario) as node,
    ):
        if not environment.prefer_punctuality():
            print(_NO_REAL_TIME, file=sys.stderr, flush=True)

        def configure() -> BridgeNode:
            try:
                from ptnsbc_nodes.bridge.bridge import open_link
                from ptnsbc_nodes.bridge.bridge_node import BridgeNode, BridgeOptions
            except ImportError as error:
                missing = f"{error.name} is not installed: install the extra [mavlink]"
                raise BridgeError(missing) from None
            if scenario.plant.kind != "quadrotor":
                raise BridgeError(
                    f"{scenario.source}: plant.kind: {scenario.plant.kind}: expected quadrotor, "
                    "the only plant that flight controllers fly here"
                )
            link, edges = open_link(settings, key), CommunicationGraph(scenario, flight)
            # A bridge that is started by hand may be the only one.
            options = BridgeOptions(allow_arming, with_fleet=managed, signing_key=key)
            lifetime.bridge = BridgeNode(node, scenario, uav, edges, link, options, lifetime.end)
            return lifetime.bridge

        node.assign(configure, lifetime.land_or_end)
        code = serve_managed([node], lifetime, autostart=not managed)
        return code if lifetime.bridge is None else code or lifetime.bridge.exit_code
