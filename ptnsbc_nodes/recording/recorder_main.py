"""Process of the recorder: `python -m ptnsbc_nodes.recording.recorder_main --bag DIR --uavs N...`.

It says `ready` on stderr when it listens. At SIGINT or SIGTERM it completes the bag and prints one line of JSON
on stdout.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_nodes.runtime.signals import StopRequest, exit_on_signal

_FAILED = 1
_DRAIN_LIMIT_S = 50.0  # under load the queues hold seconds, and the launcher waits a minute


def main(argv: Sequence[str] | None = None) -> int:
    """Record until SIGINT or SIGTERM."""
    exit_on_signal()
    from ptnsbc_nodes.runtime.node_process import run

    return run(_parser(), argv, _serve)


def _serve(options: argparse.Namespace, argv: list[str]) -> int:
    from ptnsbc_io.bag import BagError, BagWriter
    from ptnsbc_nodes.comm import topics
    from ptnsbc_nodes.comm.agent_messages import Transforms
    from ptnsbc_nodes.comm.seal import required_seal
    from ptnsbc_nodes.recording.fleet_recorder import LockstepRecorder, RealTimeRecorder
    from ptnsbc_nodes.recording.recorder import BagRecorder, topic_info
    from ptnsbc_nodes.runtime import environment
    from ptnsbc_nodes.runtime.launcher import report_running
    from ptnsbc_nodes.runtime.node_process import plain_node, report_finished

    def attached(name: str, path: str) -> bytes:
        try:
            return Path(path).read_bytes()
        except OSError as error:
            raise BagError(f"--attach {name}={path}: {error.strerror}: expected a file") from error

    draw = None  # markers, where no simulator draws them
    if options.draw is not None:
        from ptnsbc_nodes.comm.drawing import OdometryMarkers
        from ptnsbc_sim.scenario import load_scenario

        draw = OdometryMarkers(load_scenario(options.draw, {})).of
    kinds = {
        "lockstep": options.lockstep,
        "with_truth": options.truth,
        "with_slots": options.slots,
        "with_stream": options.stream,
    }
    every = topics.in_bag(options.uavs, **kinds)
    with StopRequest() as stop, plain_node("recorder", argv) as (node, executor):
        try:
            with BagWriter(
                options.bag,
                [topic_info(topic, lockstep=options.lockstep) for topic in every],
                attachments={name: attached(name, path) for name, path in options.attach},
                metadata=dict(options.meta),
                overwrite=options.overwrite,
            ) as writer:
                recorded = topics.recorded(options.uavs, **kinds)
                transforms = Transforms(options.uavs)
                seal = required_seal() if options.signed else None
                recorder: BagRecorder
                if options.lockstep:
                    recorder = LockstepRecorder(
                        node, writer, recorded, transforms, seal, options.silent
                    )
                else:
                    environment.prefer_punctuality(after_vehicles=True)
                    recorder = RealTimeRecorder(node, writer, recorded, transforms, draw, seal)
                print("ready", file=sys.stderr, flush=True)
                report_running()
                recorder.serve(executor, lambda: stop.came, _DRAIN_LIMIT_S)
                recorder.finish()
        except PtnsbcError as error:
            print(f"recorder: {error}", file=sys.stderr)
            return _FAILED
        # Before the middleware is shut down: that does not always return.
        refused = recorder.refusals.report()
        facts = recorder.summary(late=recorder.late, lost=recorder.lost, refused=refused)
        summary = json.dumps(facts)
        print(summary, flush=True)
        report_finished(summary)
    return 0


def _pair(text: str) -> tuple[str, str]:
    key, found, value = text.partition("=")
    if not key or not found:
        raise argparse.ArgumentTypeError(f"{text!r}: expected name=value")
    return key, value


def _parser() -> argparse.ArgumentParser:
    from ptnsbc_nodes.runtime.provenance import add_version

    parser = argparse.ArgumentParser(prog="recorder", description="Record a flight into a bag.")
    add_version(parser)
    parser.add_argument("--bag", type=Path, required=True, help="folder to create")
    parser.add_argument("--uavs", type=int, nargs="+", required=True, metavar="N")
    parser.add_argument("--lockstep", action="store_true", help="same flight, same bytes")
    parser.add_argument("--truth", action="store_true", help="the sim tells true states as well")
    parser.add_argument(
        "--slots", action="store_true", help="an epoch decides who takes which slot"
    )
    parser.add_argument("--stream", action="store_true", help="the leader takes setpoints")
    parser.add_argument(
        "--draw",
        metavar="SCENARIO",
        help="record markers of its UAVs, where no simulator draws them",
    )
    parser.add_argument("--signed", action="store_true", help="record sealed messages only")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing bag")
    parser.add_argument(
        "--silent",
        type=int,
        nargs=3,
        action="append",
        default=[],
        metavar=("N", "FIRST_NS", "END_NS"),
        help="lock-step: span in which the process of a UAV is gone and sends nothing",
    )
    parser.add_argument("--attach", type=_pair, action="append", default=[], metavar="NAME=PATH")
    parser.add_argument("--meta", type=_pair, action="append", default=[], metavar="KEY=VALUE")
    return parser


if __name__ == "__main__":
    sys.exit(main())
