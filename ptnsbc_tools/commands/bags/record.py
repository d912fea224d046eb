"""`ptnsbc record`: a recorder for a fleet that runs already, or starts later."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from ptnsbc_tools import console, ros
from ptnsbc_tools.limits import LARGEST_MB, LONGEST_S
from ptnsbc_tools.options import JsonOption, OverwriteOption

_MEGABYTE = 1_000_000


def record(
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="DIR", help="Folder of the bag. Default: bag-<time>."
        ),
    ] = None,
    topics: Annotated[
        list[str] | None,
        typer.Option(
            "--topics",
            metavar="PATTERN",
            help="Names with * and ?, repeatable. Default: all topics of a flight.",
        ),
    ] = None,
    scenario: Annotated[
        str | None,
        typer.Option(
            "--scenario", metavar="SCENARIO", help="Scenario that is flown, to attach to the bag."
        ),
    ] = None,
    split_size: Annotated[
        float | None,
        typer.Option(
            "--split-size",
            metavar="MB",
            min=1.0,
            max=LARGEST_MB,
            help="Start another file at this size.",
        ),
    ] = None,
    split_duration: Annotated[
        float | None,
        typer.Option(
            "--split-duration",
            metavar="S",
            min=0.1,
            max=LONGEST_S,
            help="Start another file after so long.",
        ),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            "--duration",
            metavar="S",
            min=0.1,
            max=LONGEST_S,
            help="Stop after so long. Default: at Ctrl-C.",
        ),
    ] = None,
    overwrite: OverwriteOption = False,
    json: JsonOption = False,
) -> None:
    """Record topics of a running fleet, with the quality of service of their publishers.

    Ctrl-C completes the bag. Topics that appear later are recorded from then on.
    """
    with ros.required():
        from ptnsbc_io.bag import SplitLimits
        from ptnsbc_nodes.recording.topic_recorder import OURS, RecordOptions
        from ptnsbc_nodes.recording.topic_recorder import record as run
    size = None if split_size is None else round(split_size * _MEGABYTE)
    length = None if split_duration is None else round(split_duration * 1e9)
    request = RecordOptions(
        bag=output or Path(f"bag-{datetime.now():%Y%m%d-%H%M%S}"),
        topics=tuple(topics or OURS),
        limits=SplitLimits(size, length),
        overwrite=overwrite,
        duration_s=duration,
        **_of_scenario(scenario),
    )
    done = run(request, console.say)
    if json:
        console.print_json(done)
        return
    for name, count in done["topics"].items():
        print(f"{count:8d}  {name}")
    print(f"{done['messages']} messages: {done['bag']}")


def _of_scenario(name: str | None) -> dict[str, Any]:
    if name is None:
        return {}
    from ptnsbc_sim.scenario import load_scenario
    from ptnsbc_tools.reading.bag_sources import SCENARIO_ATTACHMENT

    flown = load_scenario(name)
    return {
        "attachments": {SCENARIO_ATTACHMENT: flown.text.encode()},
        "meta": {"scenario": flown.name},
    }
