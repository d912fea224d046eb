"""`ptnsbc replay`: re-run a bag through the controllers, or play it back onto its topics."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ptnsbc_tools import console
from ptnsbc_tools.options import JsonOption

if TYPE_CHECKING:
    from ptnsbc_tools.replay.rerun import Rerun

BagArgument = Annotated[
    Path, typer.Argument(metavar="BAG", help="Folder of a bag, or its .mcap file.")
]


def replay(
    bag: BagArgument,
    rerun: Annotated[
        bool, typer.Option("--rerun", help="Feed the recorded inputs through the controllers.")
    ] = False,
    scenario: Annotated[
        Path | None,
        typer.Option("--scenario", metavar="FILE", help="Instead of the scenario in the bag."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Compare every output of every UAV with the recording, byte for byte (--rerun).

    Exit codes: 0 equal, 1 different or void, 2 refused.
    """
    if not rerun:
        raise typer.BadParameter("expected --rerun")
    raise typer.Exit(_rerun(bag, scenario, json=json))


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
    from ptnsbc_nodes.bag import read_bag
    from ptnsbc_tools.bag_reader import scenario_of
    from ptnsbc_tools.replay.rerun import rerun

    bag = read_bag(path)
    flown = scenario_of(bag, scenario)
    with console.compiling():
        from ptnsbc_nodes.warmup import load_agent

        load_agent(flown, flown.leader_id)
    with console.progress("re-running") as advance:
        return rerun(bag, flown, advance)
