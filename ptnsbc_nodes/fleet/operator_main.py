"""Process of the operator's interface: the fleet in messages, services and an action of ptnsbc_interfaces.

`python -m ptnsbc_nodes.fleet.operator_main --scenario FILE`
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.signals import exit_on_signal


class OperatorError(PtnsbcError):
    """The interface cannot be offered."""


def main(argv: Sequence[str] | None = None) -> int:
    """Serve until SIGINT or SIGTERM."""
    exit_on_signal()
    from ptnsbc_nodes.runtime.process import Arguments, run

    parser = Arguments("operator", "Offers a running fleet as ptnsbc_interfaces: state, legs, stop")
    return run(parser, argv, _serve)


def _serve(arguments: argparse.Namespace, argv: list[str]) -> int:
    from ptnsbc_nodes.comm.seal import seal_of
    from ptnsbc_nodes.runtime import process as processes
    from ptnsbc_sim.scenario import load_scenario

    try:
        from ptnsbc_nodes.fleet.operator_node import OperatorNode
    except ModuleNotFoundError as error:
        if error.name != "ptnsbc_interfaces":
            raise
        raise OperatorError(
            "the messages of ptnsbc_interfaces are not built: expected g++ and `make setup`, "
            "or with ROS from apt `colcon build` and its setup.bash"
        ) from None
    scenario = load_scenario(arguments.scenario)
    lifetime = processes.ProcessLifetime()
    with processes.ros_node("operator", "", argv) as node:
        operator = OperatorNode(node, scenario, node.context.get_domain_id(), seal_of(scenario))
        lifetime.serve(node, operator)
        operator.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
