"""Process of the recorder: `python -m ptnsbc_nodes.recording.main --bag DIR --uavs N...`.

It says `ready` on stderr when it listens, and at SIGINT or SIGTERM completes the bag and prints one line of JSON
on stdout.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.bag import BagError, BagWriter
from ptnsbc_nodes.comm import topics
from ptnsbc_nodes.comm.tf import Transforms
from ptnsbc_nodes.recording.fleet_recorder import FleetRecorder, topic_info
from ptnsbc_nodes.recording.session import account, listen, listening_node
from ptnsbc_nodes.runtime import environment
from ptnsbc_nodes.runtime.dds_profiles import NetworkError
from ptnsbc_nodes.runtime.provenance import add_version
from ptnsbc_nodes.runtime.ros_args import RosArgumentsError, ros_errors, without_ros
from ptnsbc_nodes.runtime.signals import StopRequest

if TYPE_CHECKING:
    from ptnsbc_nodes.recording.marker_frames import MarkerFrames

_DRAIN_LIMIT_S = 50.0  # under load the queues hold seconds, and the launcher waits a minute


def main(argv: Sequence[str] | None = None) -> int:
    """Record until SIGINT or SIGTERM."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    context = Context()
    with StopRequest() as stop:
        try:
            environment.prepare()
            options = _parser().parse_args(without_ros(arguments))
            if options.punctual:
                environment.prefer_punctuality(flies=False)
            with ros_errors():
                rclpy.init(
                    args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO
                )
            _record(context, options, stop)
        except (RosArgumentsError, NetworkError) as error:
            print(f"recorder: {error}", file=sys.stderr)
            return 2
        except PtnsbcError as error:
            print(f"recorder: {error}", file=sys.stderr)
            return 1
        finally:
            rclpy.try_shutdown(context=context)
    return 0


def _record(context: Context, options: argparse.Namespace, stop: StopRequest) -> None:
    lockstep = options.lockstep
    kinds = {"lockstep": lockstep, "with_truth": options.truth}
    infos = [topic_info(one, lockstep=lockstep) for one in topics.in_bag(options.uavs, **kinds)]
    with listening_node(context, "recorder") as (node, executor):
        with BagWriter(
            options.bag,
            infos,
            attachments={name: _content(name, path) for name, path in options.attach},
            metadata=dict(options.meta),
            overwrite=options.overwrite,
        ) as writer:
            recorder = FleetRecorder(
                node,
                writer,
                topics.recorded(options.uavs, **kinds),
                Transforms(options.uavs),
                lockstep=lockstep,
                pictures=_pictures(options.draw),
            )
            print("ready", file=sys.stderr, flush=True)
            listen(executor, recorder, lambda: stop.came, _DRAIN_LIMIT_S)
            recorder.finish()
        # Before the middleware is taken down: whether that ends is not ours to promise.
        print(json.dumps(account(writer, recorder, late=recorder.late)), flush=True)


def _pictures(scenario: str | None) -> MarkerFrames | None:
    if scenario is None:
        return None
    from ptnsbc_nodes.recording.marker_frames import MarkerFrames
    from ptnsbc_sim.scenario import load_scenario

    return MarkerFrames(load_scenario(scenario, {}))


def _content(name: str, path: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise BagError(f"--attach {name}={path}: {error.strerror}: expected a file") from error


def _pair(text: str) -> tuple[str, str]:
    key, found, value = text.partition("=")
    if not key or not found:
        raise argparse.ArgumentTypeError(f"{text!r}: expected name=value")
    return key, value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="recorder", description="Record a flight into a bag.")
    add_version(parser)
    parser.add_argument("--bag", type=Path, required=True, help="folder to create")
    parser.add_argument("--uavs", type=int, nargs="+", required=True, metavar="N")
    parser.add_argument("--lockstep", action="store_true", help="same flight, same bytes")
    parser.add_argument("--truth", action="store_true", help="the sim tells true states as well")
    parser.add_argument(
        "--draw",
        metavar="SCENARIO",
        help="record markers of its UAVs, where no simulator draws them",
    )
    parser.add_argument(
        "--punctual", action="store_true", help="run before all that does not fly, where allowed"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace an existing bag")
    parser.add_argument("--attach", type=_pair, action="append", default=[], metavar="NAME=PATH")
    parser.add_argument("--meta", type=_pair, action="append", default=[], metavar="KEY=VALUE")
    return parser


if __name__ == "__main__":
    sys.exit(main())
