"""Process of one bridge: `python -m ptnsbc_nodes.bridge.main --scenario FILE --uav N`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, cast

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.comm.graph import CommunicationGraph
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.lifecycle_node import ManagedNode
from ptnsbc_nodes.runtime.parameters import (
    AUTOSTART,
    SCENARIO,
    UAV,
    NodeParameters,
    ReadOnlyParameter,
    overrides,
)
from ptnsbc_nodes.runtime.process import (
    Arguments,
    ProcessLifetime,
    namespace_of,
    parameter_node,
    run,
    serve_managed,
)
from ptnsbc_nodes.runtime.scenario_parameters import Value
from ptnsbc_sim.scenario import Scenario

if TYPE_CHECKING:
    from ptnsbc_io.mavlink.link import MavlinkLink
    from ptnsbc_nodes.bridge.node import BridgeNode


_UNPUNCTUAL = "bridge: no right to real-time scheduling: a busy host may hold setpoints up (ulimit -r above 0 gives it)"


class BridgeError(PtnsbcError):
    """A bridge that cannot be opened."""


@dataclass(frozen=True)
class BridgeOptions:
    """Which vehicle, and what may be done with it."""

    uav: int
    allow_arming: bool = False
    signing_key: Path | None = None  # instead of the scenario's
    recorded: bool = False


class _LandingLifetime(ProcessLifetime):
    """The first request to end lands the vehicle, the second one ends the process."""

    def __init__(self) -> None:
        super().__init__()
        self.shell: BridgeNode | None = None
        self._asked = False

    def land_or_end(self) -> None:
        """Land what flies; end when nothing does, or when asked again."""
        if not self._lands():
            self.end()

    def _lands(self) -> bool:
        asked, self._asked = self._asked, True
        if asked or self.shell is None or not self.shell.land():
            return False
        print("bridge: landing; once more to end at once", file=sys.stderr, flush=True)
        return True

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if not self._lands():
            super()._on_signal(number, frame)


_FIXED = (
    *SCENARIO,
    UAV,
    AUTOSTART,
    ReadOnlyParameter("signing_key", "", "key file, instead of the scenario's"),
    ReadOnlyParameter("allow_arming", False, "arm and take off"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Bridge until the vehicle has landed, or for ever when it never flies."""
    parser = Arguments("bridge", "MAVLink bridge of one UAV", scenario=False)
    parser.add_argument("--uav", type=int, metavar="N", help="id of this UAV")
    parser.add_argument("--connect", help="instead of the scenario's link to the vehicle")
    parser.add_argument("--signing-key", type=Path, help="instead of the scenario's key file")
    parser.add_argument("--allow-arming", action="store_true", help="arm and take off")
    parser.add_argument("--managed", action="store_true", help="wait to be configured")
    return run(parser, argv, _bridge)


def _bridge(arguments: argparse.Namespace, argv: list[str]) -> int:
    given: dict[str, Value | None] = {
        "scenario": arguments.scenario,
        "uav": arguments.uav,
        "recorded": arguments.recorded,
        "signing_key": str(arguments.signing_key or ""),
        "allow_arming": arguments.allow_arming,
    }
    if arguments.connect is not None:
        if arguments.uav is None:
            raise BridgeError(f"--connect {arguments.connect}: expected --uav N as well")
        given[f"mavlink.vehicles.{arguments.uav}.connect"] = arguments.connect
    return _serve(given, argv, managed=arguments.managed)


def bridge(scenario: Scenario, options: BridgeOptions, argv: Sequence[str]) -> int:
    """Bridge one vehicle until it has landed, or a signal; `argv` is for ROS."""
    given: dict[str, Value | None] = {
        "scenario_text": scenario.text,
        "uav": options.uav,
        "recorded": options.recorded,
        "signing_key": str(options.signing_key or ""),
        "allow_arming": options.allow_arming,
    }
    return _serve(given, argv, managed=False)


def _serve(given: Mapping[str, Value | None], argv: Sequence[str], *, managed: bool) -> int:
    lifetime = _LandingLifetime()
    namespace = namespace_of(cast("int | None", given["uav"]))
    with parameter_node("bridge", namespace, argv, overrides(given), ManagedNode) as node:
        told = NodeParameters(node, _FIXED, bridged=True)
        told.declare_scenario(may_change=lambda: node.state == "unconfigured")
        if not environment.prefer_punctuality(flies=True):
            print(_UNPUNCTUAL, file=sys.stderr, flush=True)
        node.assign(lambda: _opened(node, told, lifetime), lifetime.land_or_end)
        code = serve_managed(node, lifetime, autostart=told["autostart"] and not managed)
        return code if lifetime.shell is None else code or lifetime.shell.exit_code


def _opened(node: ManagedNode, told: NodeParameters, lifetime: _LandingLifetime) -> BridgeNode:
    """The bridge with its link open; what configuring does."""
    key = Path(told["signing_key"]) if told["signing_key"] else None
    link = _open(told.scenario, told.uav, key)
    from ptnsbc_nodes.bridge.node import BridgeNode

    edges = CommunicationGraph(told.scenario, told.options)
    lifetime.shell = BridgeNode(
        node, told.scenario, told.uav, edges, link, told["allow_arming"], lifetime.end
    )
    return lifetime.shell


def _open(scenario: Scenario, uav_id: int, key_file: Path | None) -> MavlinkLink:
    """The link to the vehicle of one UAV."""
    try:
        from ptnsbc_io.mavlink.link import MavlinkLink
        from ptnsbc_io.mavlink.signing import Signer, read_key
        from ptnsbc_io.mavlink.transport import connect
        from ptnsbc_nodes.bridge.bridge import WANTED_MESSAGES
    except ImportError as error:
        raise BridgeError(f"{error.name} is not installed: install the extra [mavlink]") from None
    reached = scenario.vehicle_link(uav_id)
    if scenario.plant_kind != "quadrotor":
        raise BridgeError(
            f"{scenario.source}: plant.kind: {scenario.plant_kind}: expected quadrotor, "
            "flight controllers fly nothing else here"
        )
    key = key_file or (Path(reached.signing_key) if reached.signing_key else None)
    signer = None if key is None else Signer(read_key(key))
    return MavlinkLink(connect(reached.connect), reached.sysid, WANTED_MESSAGES, signer)


if __name__ == "__main__":
    raise SystemExit(main())
