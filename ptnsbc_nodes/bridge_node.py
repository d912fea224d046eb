"""Process of one bridge: `python -m ptnsbc_nodes.bridge_node --scenario FILE --uav N`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes import environment
from ptnsbc_nodes.edges import Edges, FlightOptions
from ptnsbc_nodes.process import Arguments, Lifetime, ros_node, run
from ptnsbc_sim.scenario import Scenario, load_scenario

if TYPE_CHECKING:
    from ptnsbc_nodes.mavlink.link import Link


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


class _LandingLifetime(Lifetime):
    """The first signal lands the vehicle, the second one ends the process."""

    def __init__(self) -> None:
        super().__init__()
        self.land: Callable[[], bool] = lambda: False

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        land, self.land = self.land, lambda: False
        if land():
            print("bridge: landing; once more to end at once", file=sys.stderr, flush=True)
        else:
            super()._on_signal(number, frame)


def main(argv: Sequence[str] | None = None) -> int:
    """Bridge until the vehicle has landed, or for ever when it never flies."""
    parser = Arguments("bridge", "MAVLink bridge of one UAV")
    parser.add_argument("--uav", required=True, type=int, metavar="N", help="id of this UAV")
    parser.add_argument("--connect", help="instead of the scenario's link to the vehicle")
    parser.add_argument("--signing-key", type=Path, help="instead of the scenario's key file")
    parser.add_argument("--allow-arming", action="store_true", help="arm and take off")
    return run(parser, argv, _bridge)


def _bridge(arguments: argparse.Namespace, argv: list[str]) -> int:
    overrides = {f"mavlink.vehicles.{arguments.uav}.connect": arguments.connect}
    scenario = load_scenario(arguments.scenario, overrides).bridged()
    options = BridgeOptions(
        arguments.uav, arguments.allow_arming, arguments.signing_key, arguments.recorded
    )
    return bridge(scenario, options, argv)


def bridge(scenario: Scenario, options: BridgeOptions, argv: Sequence[str]) -> int:
    """Bridge one vehicle until it has landed, or a signal; `argv` is for ROS."""
    lifetime = _LandingLifetime()
    link = _open(scenario, options.uav, options.signing_key)
    from ptnsbc_nodes.bridge.node import BridgeNode

    edges = Edges(scenario, FlightOptions(recorded=options.recorded, bridged=True))
    if not environment.prefer_punctuality(flies=True):
        print(_UNPUNCTUAL, file=sys.stderr, flush=True)
    with ros_node("bridge", f"/uav{options.uav}", argv) as node:
        shell = BridgeNode(
            node, scenario, options.uav, edges, link, options.allow_arming, lifetime.end
        )
        lifetime.land = shell.land
        shell.start()
        lifetime.serve(node, shell.endpoints)
        shell.close()
    return shell.exit_code


def _open(scenario: Scenario, uav_id: int, key_file: Path | None) -> Link:
    """The link to the vehicle of one UAV."""
    try:
        from ptnsbc_nodes.bridge.bridge import WANTED_MESSAGES
        from ptnsbc_nodes.mavlink.link import Link
        from ptnsbc_nodes.mavlink.signing import Signer, read_key
        from ptnsbc_nodes.mavlink.transport import connect
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
    return Link(connect(reached.connect), reached.sysid, WANTED_MESSAGES, signer)


if __name__ == "__main__":
    raise SystemExit(main())
