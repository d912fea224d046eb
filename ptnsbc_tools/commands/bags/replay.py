"""`ptnsbc replay`: run a bag through the controllers again, or publish it on its topics."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ptnsbc_tools import console, ros
from ptnsbc_tools.limits import FASTEST_HZ, LONGEST_S
from ptnsbc_tools.options import BagArgument, JsonOption

if TYPE_CHECKING:
    from rich.table import Table

    from ptnsbc_tools.replay.rerun import Rerun

_INTERRUPTED = 130


def replay(
    bag: BagArgument,
    rerun: Annotated[
        bool, typer.Option("--rerun", help="Feed the recorded inputs through the controllers.")
    ] = False,
    publish: Annotated[
        bool, typer.Option("--publish", help="Publish the messages on their topics, over DDS.")
    ] = False,
    scenario: Annotated[
        Path | None,
        typer.Option(
            "--scenario",
            metavar="FILE",
            help="--rerun: use this file and not the attached scenario.",
        ),
    ] = None,
    law: Annotated[
        str | None,
        typer.Option(
            "--law",
            metavar="FILE.py:NAME",
            help="--rerun: execute this law, of a bag whose scenario names one.",
        ),
    ] = None,
    plugin: Annotated[
        list[str] | None,
        typer.Option(
            "--plugin",
            metavar="FILE.py:NAME",
            help="--rerun: execute this task or controller, of a bag whose scenario names it; repeatable.",
        ),
    ] = None,
    rate: Annotated[
        float,
        typer.Option(
            "--rate", metavar="X", min=0.001, help="--publish: speed in multiples of real time."
        ),
    ] = 1.0,
    start: Annotated[
        float,
        typer.Option(
            "--start",
            metavar="S",
            min=0.0,
            max=LONGEST_S,
            help="--publish: skip the first S seconds.",
        ),
    ] = 0.0,
    loop: Annotated[bool, typer.Option("--loop", help="--publish: repeat until Ctrl-C.")] = False,
    topics: Annotated[
        list[str] | None,
        typer.Option(
            "--topics", metavar="PATTERN", help="--publish: names with * and ?, repeatable."
        ),
    ] = None,
    clock: Annotated[
        float | None,
        typer.Option(
            "--clock",
            metavar="HZ",
            min=0.1,
            max=FASTEST_HZ,
            help="--publish: also publish the time of the bag on /clock.",
        ),
    ] = None,
    wait: Annotated[
        float,
        typer.Option(
            "--wait",
            metavar="S",
            min=0.0,
            max=LONGEST_S,
            help="--publish: wait at most so long for subscribers.",
        ),
    ] = 1.0,
    json: JsonOption = False,
) -> None:
    """Run a bag through the controllers again (--rerun), or publish it on its topics (--publish).

    --rerun compares every output of every UAV with the recording, byte for byte, and names the first
    difference. Exit codes: 0 equal, or played; 1 different or void; 2 refused; 130 interrupted.
    """
    if rerun == publish:
        raise typer.BadParameter("expected one of --rerun and --publish")
    if rerun:
        raise typer.Exit(_rerun(bag, scenario, law, plugin or [], json=json))
    chosen = tuple(topics or ("*",))
    raise typer.Exit(
        _publish(
            bag,
            json,
            topics=chosen,
            rate=rate,
            start_s=start,
            loop=loop,
            clock_hz=clock,
            wait_s=wait,
        )
    )


def _publish(path: Path, json: bool, **play_options: Any) -> int:
    from ptnsbc_io.bag import read_bag

    bag = read_bag(path)
    with ros.required():
        from ptnsbc_nodes.recording import player
    with console.progress("playing") as advance:
        played = player.play(bag, player.PlayOptions(**play_options), console.say, advance)
    if json:
        console.print_json(vars(played))
    else:
        late = f"at most {1e3 * played.latest_s:.1f} ms late"
        print(f"{played.messages} messages played in {played.rounds} rounds, {late}")
    return _INTERRUPTED if played.interrupted else 0


def _rerun(
    path: Path, scenario: Path | None, law: str | None, plugins: list[str], *, json: bool
) -> int:
    from ptnsbc_tools.library.bags import rerun
    from ptnsbc_tools.replay.rerun import EQUAL

    began = time.monotonic()
    done = rerun(path, scenario=scenario, law=law, plugins=plugins, progress=True)
    seconds = time.monotonic() - began
    if json:
        console.print_json(done.as_json(seconds))
    else:
        out = console.out()
        out.print(_table(done))
        for line in _lines(done, seconds):
            out.print(line, soft_wrap=True, highlight=False)
    return 0 if done.verdict == EQUAL else 1


def _table(done: Rerun) -> Table:
    from rich.table import Table

    table = Table(title="re-run")
    for name in ("UAV", "steps", "compared", "before the first leg", "not re-run", "not recorded"):
        table.add_column(name, justify="right")
    table.add_column("result")
    for uav, one in done.accounts.items():
        left_out = sum(gap.steps for gap in one.gaps)
        figures = (one.steps, one.compared, one.waiting, left_out, one.unrecorded)
        void = one.gaps or one.unrecorded or not one.compared
        result = "void" if void else "equal"
        if one.difference is not None:
            result = f"different from tick {one.difference.tick}"
        table.add_row(str(uav), *map(str, figures), result)
    return table


def _lines(done: Rerun, seconds: float) -> Iterator[str]:
    """The sentences below the table, the verdict last."""
    for uav, one in done.accounts.items():
        for gap in one.gaps:
            span = f"t = {gap.first_s:.3f} s to {gap.last_s:.3f} s"
            yield f"uav{uav}: void from {span}, {gap.steps} steps: {gap.reason}"
        if one.unrecorded:
            yield f"uav{uav}: {one.unrecorded} of its outputs are not in the recording"
        if one.silent:
            yield f"uav{uav}: nothing of it is recorded for the last {one.silent} steps"
    steps = sum(one.steps for one in done.accounts.values())
    speed = f"{done.flown_s:.1f} s of flight in {seconds:.1f} s"
    if done.first is not None:
        yield f"different: {done.first}"
    elif done.verdict == "equal":
        outputs = sum(one.compared for one in done.accounts.values())
        yield f"equal: {steps} steps, {outputs} outputs, byte for byte; {speed}"
    else:
        yield f"void: what could be re-run is equal ({steps} steps), but not all could; {speed}"
