"""Process of the operator's interface: the fleet in messages, services and an action of ptnsbc_interfaces.

`python -m ptnsbc_nodes.view.operator_main [--scenario FILE]`; without a scenario it asks a UAV of the fleet.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.signals import exit_on_signal

_PATIENCE_S = 30.0


def main(argv: Sequence[str] | None = None) -> int:
    """Serve until SIGINT or SIGTERM."""
    exit_on_signal()
    from ptnsbc_nodes.runtime.node_process import Arguments, run

    parser = Arguments(
        "operator", "Offers a running fleet as ptnsbc_interfaces: state, legs, stop", scenario=False
    )
    return run(parser, argv, _serve)


def _serve(arguments: argparse.Namespace, argv: list[str]) -> int:
    from ptnsbc_nodes.runtime.node_process import (
        ProcessLifetime,
        flown,
        options_of,
        ros_context,
        ros_node,
    )
    from ptnsbc_nodes.view.observer import Observer

    try:
        from ptnsbc_nodes.view.operator_node import OperatorNode
    except ImportError as error:
        if (error.name or "").partition(".")[0] != "ptnsbc_interfaces":
            raise
        raise PtnsbcError(
            "the messages of ptnsbc_interfaces are not built, or older than this program: "
            "expected g++ and `make setup-messages`, or with ROS from apt `colcon build` and its setup.bash"
        ) from None
    lifetime = ProcessLifetime()
    with ros_context(argv), ros_node("operator", "") as node:
        if arguments.scenario:
            scenario = flown(arguments)
        else:
            namespace = node.get_namespace().rstrip("/")
            domain = node.context.get_domain_id()
            with Observer(domain, namespace, "operator_lookup", node.context) as observer:
                scenario = observer.scenario(_PATIENCE_S, lambda: lifetime.over)
        seal = options_of(scenario).seal
        operator = OperatorNode(node, scenario, node.context.get_domain_id(), seal)
        lifetime.serve([node], lambda: [operator.endpoints])
        operator.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
