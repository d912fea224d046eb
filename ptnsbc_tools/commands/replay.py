"""`ptnsbc replay`: re-run a bag through the controllers, or play it back onto its topics."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ptnsbc_tools import console
from ptnsbc_tools.options import JsonOption

if TYPE_CHECKING:
    from ptnsbc_tools.replay.rerun import Rerun

_MOST_JOBS = 4

BagArgument = Annotated[
    Path, typer.Argument(metavar="BAG", help="Folder of a bag, or its .mcap file.")
]


def replay(
    bag: BagArgument,
    rerun: Annotated[
        bool, typer.Option("--rerun", help="Feed the recorded inputs through the controllers.")
    ] = False,
    publish: Annotated[
        bool, typer.Option("--publish", help="Play the bag back onto its topics, over DDS.")
    ] = False,
    scenario: Annotated[
        Path | None,
        typer.Option("--scenario", metavar="FILE", help="--rerun: instead of the one in the bag."),
    ] = None,
    rate: Annotated[
        float, typer.Option("--rate", metavar="X", min=0.001, help="--publish: times real time.")
    ] = 1.0,
    start: Annotated[
        float, typer.Option("--start", metavar="S", min=0.0, help="--publish: skip so much.")
    ] = 0.0,
    loop: Annotated[
        bool, typer.Option("--loop", help="--publish: again and again, until Ctrl-C.")
    ] = False,
    topics: Annotated[
        list[str] | None,
        typer.Option(
            "--topics", metavar="PATTERN", help="--publish: names with * and ?, repeatable."
        ),
    ] = None,
    clock: Annotated[
        float | None,
        typer.Option("--clock", metavar="HZ", min=0.1, help="--publish: /clock of the bag's time."),
    ] = None,
    wait: Annotated[
        float, typer.Option("--wait", metavar="S", min=0.0, help="--publish: for readers, at most.")
    ] = 1.0,
    json: JsonOption = False,
) -> None:
    """Run a bag through the controllers again (--rerun), or play it back onto its topics (--publish).

    --rerun compares every output of every UAV with the recording, byte for byte, and names the first
    difference. Exit codes: 0 equal, or played; 1 different or void; 2 refused; 130 interrupted.
    """
    if rerun == publish:
        raise typer.BadParameter("expected one of --rerun and --publish")
    if rerun:
        raise typer.Exit(_rerun(bag, scenario, json=json))
    from ptnsbc_tools.replay import playing

    chosen = tuple(topics or ("*",))
    wishes = playing.PlayArguments(chosen, rate, start, loop, clock, wait)
    raise typer.Exit(playing.publish(bag, wishes, json=json))


def _rerun(path: Path, scenario: Path | None, *, json: bool) -> int:
    from ptnsbc_tools.replay import account
    from ptnsbc_tools.replay.rerun import EQUAL

    began = time.monotonic()
    done = _again(path, scenario)
    seconds = time.monotonic() - began
    if json:
        console.print_json(account.as_json(done, seconds))
    else:
        out = console.out()
        out.print(account.table(done))
        for line in account.lines(done, seconds):
            out.print(line, soft_wrap=True, highlight=False)
    return 0 if done.verdict == EQUAL else 1


def _again(path: Path, scenario: Path | None) -> Rerun:
    from ptnsbc_io.bag import read_bag
    from ptnsbc_tools.reading.bag_reader import scenario_of
    from ptnsbc_tools.replay.rerun import rerun

    bag = read_bag(path)
    flown = scenario_of(bag, scenario)
    with console.compiling():
        from ptnsbc_nodes.runtime.warmup import load_agent

        load_agent(flown, flown.leader_id)
    jobs = min(os.cpu_count() or 1, _MOST_JOBS)
    return rerun(bag, flown, lambda: console.progress("re-running"), jobs)
