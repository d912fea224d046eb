"""The process of one bridge: it makes the node and its link, and serves them until their end."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from types import FrameType
from typing import TYPE_CHECKING

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.lifecycle_node import ManagedNode
from ptnsbc_nodes.runtime.node_parameters import AUTOSTART, SCENARIO, UAV, NodeParameters, overrides
from ptnsbc_nodes.runtime.node_process import ProcessLifetime, ros_context, ros_node, serve_managed
from ptnsbc_nodes.runtime.scenario_parameters import DescribedValue, Value

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


_FIXED = (
    *SCENARIO,
    UAV,
    AUTOSTART,
    DescribedValue("signing_key", "", "key file, instead of the scenario's"),
    DescribedValue("allow_arming", False, "arm and take off"),
)


def serve_bridge(given: Mapping[str, Value | None], argv: Sequence[str], *, managed: bool) -> int:
    """Bridge one vehicle until it has landed, or a signal; returns the exit code.

    `given` are values of the node's parameters, `argv` is for ROS; a `managed` bridge waits to be configured.
    """
    lifetime = _LandingLifetime()
    namespace = "" if given["uav"] is None else f"/uav{given['uav']}"
    with (
        ros_context(argv),
        ros_node("bridge", namespace, make=ManagedNode, parameters=overrides(given)) as node,
    ):
        parameters = NodeParameters(node, _FIXED, bridged=True, fixed=node.fixed)
        if not environment.prefer_punctuality():
            print(_NO_REAL_TIME, file=sys.stderr, flush=True)

        def configure() -> BridgeNode:
            try:
                from ptnsbc_nodes.bridge.bridge import open_link
                from ptnsbc_nodes.bridge.bridge_node import BridgeNode, BridgeOptions
            except ImportError as error:
                missing = f"{error.name} is not installed: install the extra [mavlink]"
                raise BridgeError(missing) from None
            scenario, uav = parameters.scenario, parameters.uav
            if scenario.plant.kind != "quadrotor":
                raise BridgeError(
                    f"{scenario.source}: plant.kind: {scenario.plant.kind}: expected quadrotor, "
                    "the only plant that flight controllers fly here"
                )
            settings = scenario.vehicle_link(uav)
            key = str(parameters["signing_key"] or settings.signing_key or "")
            link, edges = open_link(settings, key), CommunicationGraph(scenario, parameters.options)
            # A bridge that is started by hand may be the only one.
            options = BridgeOptions(parameters["allow_arming"], with_fleet=managed, signing_key=key)
            lifetime.bridge = BridgeNode(node, scenario, uav, edges, link, options, lifetime.end)
            return lifetime.bridge

        node.assign(configure, lifetime.land_or_end)
        code = serve_managed([node], lifetime, autostart=parameters["autostart"] and not managed)
        return code if lifetime.bridge is None else code or lifetime.bridge.exit_code
