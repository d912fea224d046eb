"""`ptnsbc record`: a recorder beside a fleet that runs already, or starts later."""

from __future__ import annotations

import sys
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from ptnsbc_tools import console, ros
from ptnsbc_tools.options import JsonOption, OverwriteOption

_MEGABYTE = 1_000_000


def record(
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="DIR", help="Folder of the bag; bag-<time> if absent."
        ),
    ] = None,
    topics: Annotated[
        list[str] | None,
        typer.Option(
            "--topics",
            metavar="PATTERN",
            help="Names with * and ?, repeatable; default: a flight's.",
        ),
    ] = None,
    scenario: Annotated[
        str | None,
        typer.Option(
            "--scenario", metavar="SCENARIO", help="What is flown, to be kept in the bag."
        ),
    ] = None,
    split_size: Annotated[
        float | None,
        typer.Option("--split-size", metavar="MB", min=1.0, help="Go on in another file then."),
    ] = None,
    split_duration: Annotated[
        float | None,
        typer.Option("--split-duration", metavar="S", min=0.1, help="Go on in another file then."),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", min=0.1, help="Stop by itself; else at Ctrl-C."),
    ] = None,
    overwrite: OverwriteOption = False,
    json: JsonOption = False,
) -> None:
    """Record topics of a running fleet, with the quality of service that their publishers offer.

    Ctrl-C completes the bag. Topics that appear later are recorded from then on.
    """
    record_, wishes_type, limits_type, ours = _needed()
    size = None if split_size is None else round(split_size * _MEGABYTE)
    length = None if split_duration is None else round(split_duration * 1e9)
    wishes = wishes_type(
        bag=output or Path(f"bag-{datetime.now():%Y%m%d-%H%M%S}"),
        topics=tuple(topics or ours),
        limits=limits_type(size, length),
        overwrite=overwrite,
        duration_s=duration,
        **_of_scenario(scenario),
    )
    done = record_(wishes, lambda line: print(line, file=sys.stderr, flush=True))
    if json:
        console.print_json(done)
        return
    for name, count in done["topics"].items():
        print(f"{count:8d}  {name}")
    print(f"{done['messages']} messages, {done['lost']} lost: {done['bag']}")


def _needed() -> Any:
    with ros.needed():
        from ptnsbc_io.bag import SplitLimits
        from ptnsbc_nodes.recording.topic_recorder import OURS, RecordOptions, record
    return record, RecordOptions, SplitLimits, OURS


def _of_scenario(name: str | None) -> dict[str, Any]:
    if name is None:
        return {}
    from ptnsbc_sim.scenario import load_scenario
    from ptnsbc_tools.reading.bag_reader import SCENARIO_ATTACHMENT

    flown = load_scenario(name)
    return {
        "attachments": {SCENARIO_ATTACHMENT: flown.text.encode()},
        "meta": {"scenario": flown.name},
    }
