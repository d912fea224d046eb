"""Process of one bridge: `python -m ptnsbc_nodes.bridge.bridge_main --scenario FILE --uav N`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ptnsbc_nodes.runtime.signals import exit_on_signal


def main(argv: Sequence[str] | None = None) -> int:
    """Bridge until the vehicle has landed; a bridge whose vehicle never flies runs until a signal."""
    exit_on_signal()
    from ptnsbc_nodes.runtime.node_process import Arguments, run

    parser = Arguments("bridge", "MAVLink bridge of one UAV")
    parser.set_defaults(bridged=True)
    parser.add_argument("--uav", type=int, required=True, metavar="N", help="id of this UAV")
    parser.add_argument("--connect", help="instead of the scenario's link to the vehicle")
    parser.add_argument("--signing-key", type=Path, help="instead of the scenario's key file")
    parser.add_argument("--allow-arming", action="store_true", help="arm and take off")
    parser.add_argument(
        "--with-fleet", action="store_true", help="arm only when all UAVs of the scenario are ready"
    )
    return run(parser, argv, _bridge)


def _bridge(arguments: argparse.Namespace, argv: list[str]) -> int:
    from ptnsbc_nodes.bridge.process import serve_bridge
    from ptnsbc_nodes.runtime.node_process import flown

    connect = {f"mavlink.vehicles.{arguments.uav}.connect": arguments.connect}
    return serve_bridge(
        flown(arguments, connect),
        arguments.uav,
        argv,
        recorded=arguments.recorded,
        signing_key=arguments.signing_key,
        allow_arming=arguments.allow_arming,
        with_fleet=arguments.with_fleet,
    )


if __name__ == "__main__":
    raise SystemExit(main())
