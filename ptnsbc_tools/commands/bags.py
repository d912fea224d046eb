"""`ptnsbc bag`: replay, show and repair bags, and the logs of autopilots beside them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_tools import console, ros
from ptnsbc_tools.limits import FASTEST_HZ, LONGEST_S
from ptnsbc_tools.options import (
    BagArgument,
    JsonOption,
    argument,
    flat,
    group,
    option,
    scenario_with,
)

if TYPE_CHECKING:
    from rich.table import Table

    from ptnsbc_io.bag import Bag
    from ptnsbc_tools.replay.rerun import Rerun

_INTERRUPTED = 130

bag = group("Replay, show or repair bags; fetch autopilots' logs.")


@bag.command()
def info(
    bag: BagArgument,
    check: Annotated[
        bool, option("--check", "Read the whole bag and compare every checksum.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Show topics, times, metadata and attachments of a bag; with --check also whether it is complete.

    Opens the remains of a killed recording too. Exit codes: 0, 1 damaged or cut (--check), 2 refused.
    """
    from ptnsbc_io.bag import BagError, read_bag
    from ptnsbc_io.bag.reader import find_problems

    found = read_bag(bag, salvage=True)
    if check and not found.files:
        raise BagError(
            f"{bag}: --check: expected MCAP files that are not packed as a whole: only they have checksums"
        )
    with console.patience(f"reading {bag}"):
        problems = find_problems(found) if check else None
    if json:
        shown = ("name", "type", "messages")
        topics = [dict(zip(shown, topic, strict=False)) for topic in found.topics.values()]
        console.print_json(
            {
                "files": [str(path) for path, _ in found.files] or [str(found.path)],
                "start_ns": found.start_ns,
                "end_ns": found.end_ns,
                "messages": sum(topic.messages for topic in found.topics.values()),
                "topics": topics,
                "metadata": dict(found.metadata),
                "attachments": list(found.attachments),
                "wrong": problems,
            }
        )
    else:
        _show(found, problems)
    if problems:
        raise typer.Exit(1)


def _show(bag: Bag, problems: list[str] | None) -> None:
    from rich.table import Table

    names = [path.name for path, _ in bag.files] or [bag.path.name]
    table = Table("topic", "type", title=", ".join(names))
    table.add_column("messages", justify="right")
    for topic in bag.topics.values():
        table.add_row(topic.name, topic.type, str(topic.messages))
    console.out().print(table)
    total = sum(topic.messages for topic in bag.topics.values())
    console.show(
        f"{console.counted(total, 'message')}, {_when(bag.start_ns)} to {_when(bag.end_ns)}"
    )
    for key, value in bag.metadata.items():
        console.show(f"{key}: {value}")
    console.show(f"attachments: {', '.join(bag.attachments) or 'none'}")
    for line in problems or ():
        console.show(f"wrong: {line}")
    if problems == []:
        print("whole: every checksum is right")


def _when(stamp_ns: int) -> str:
    """Wall time of a real-time bag, seconds of simulated time otherwise."""
    if stamp_ns < 10**17:  # before 1973: simulated time
        return f"{stamp_ns * 1e-9:.3f} s"
    return f"{datetime.fromtimestamp(stamp_ns * 1e-9, tz=timezone.utc):%Y-%m-%d %H:%M:%S.%f} UTC"


@bag.command()
def repair(
    bag: Annotated[Path, argument("BAG", "Bag, the .part of a killed recording, or .mcap file.")],
    output: Annotated[
        Path | None, option("--output -o DIR", "Write the repaired bag into this folder.")
    ] = None,
    discard: Annotated[
        bool, option("--discard", "Remove the damaged bag after the repair.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Restore the index and metadata.yaml of a cut or damaged bag, from all that can be read.

    A killed recording DIR.part becomes DIR. A damaged bag DIR is replaced and kept as DIR.original.
    """
    from ptnsbc_tools.library import bags as library

    made = library.repair(bag, output, discard=discard, progress=True)
    if json:
        original = None if made.original is None else str(made.original)
        console.print_json(made._asdict() | {"bag": str(made.bag), "original": original})
        return
    lost = ["the end was missing"] if made.cut else []
    if made.damaged_chunks:
        lost.append(f"{console.counted(made.damaged_chunks, 'damaged chunk')} left out")
    if made.wrong_times:
        lost.append(f"{console.counted(made.wrong_times, 'wrong log time')} mended")
    rescued = console.counted(made.messages, "message")
    print(f"{rescued} rescued; {'; '.join(lost) or 'nothing was missing'}")
    print(f"bag: {made.bag}")
    print(f"original: {made.original or 'discarded'}")


@bag.command()
def logs(
    bag: Annotated[Path, argument("BAG", "Folder of the bag of the flight.")],
    scenario: Annotated[
        str | None,
        argument(
            "[SCENARIO]", "The links to the vehicles. Default: as in the scenario of the bag."
        ),
    ] = None,
    overwrite: Annotated[bool, option("--overwrite", "Replace logs that are there.")] = False,
    patience: Annotated[
        float, option("--patience S", "Give a vehicle up that is silent so long.", 1.0, LONGEST_S)
    ] = 10.0,
) -> None:
    """Fetch each autopilot's newest log by MAVLink, after the flight, and lay it into the folder of its bag.

    The vehicles stand disarmed on the ground, and no bridge runs. PX4's log is uav1.ulg, any other's uav1.bin.
    Exit codes: 0, 1 not all fetched, 2 refused.
    """
    from ptnsbc_io.bag import read_bag
    from ptnsbc_tools.reading.bag_reader import scenario_of

    with ros.required("install the extra [mavlink]"):
        from ptnsbc_io.mavlink.link import link_to
        from ptnsbc_io.mavlink.log_download import WANTED, LogDownload, LogError, fetch_logs
    found = read_bag(bag)
    if not bag.is_dir():
        raise LogError(f"{bag}: expected the folder of a bag")
    flown = scenario_of(found, None) if scenario is None else scenario_with(scenario, {})
    problems: dict[str, str] = {}
    downloads: dict[str, LogDownload] = {}
    for uav in flown.uav_ids:
        link = flown.vehicle_link(uav)
        name = f"uav{uav} ({link.label})" if link.label else f"uav{uav}"
        path = bag / f"uav{uav}{'.ulg' if link.autopilot == 'px4' else '.bin'}"
        try:
            if path.exists() and not overwrite:
                raise LogError(f"{path} exists: move it away, or give --overwrite")
            opened = link_to(link.connect, link.sysid, WANTED, link.signing_key or "", 1)
            downloads[name] = LogDownload(opened, link.sysid, path, patience)
        except PtnsbcError as error:
            problems[name] = str(error)
    with console.progress("logs") as advance:
        fetch_logs(list(downloads.values()), advance)
    for name, one in downloads.items():
        if one.problem:
            problems[name] = one.problem
        else:
            print(f"{name}: {one.size} bytes: {one.path}")
    for name, problem in problems.items():
        console.say(f"{name}: {problem}")
    raise typer.Exit(1 if problems else 0)


@dataclass(frozen=True)
class Playing:
    """Options of playing a bag."""

    rate: Annotated[
        float, option("--rate X", "--publish: speed in multiples of real time.", 0.001)
    ] = 1.0
    start_s: Annotated[
        float, option("--start S", "--publish: skip the first S seconds.", 0.0, LONGEST_S)
    ] = 0.0
    loop: Annotated[bool, option("--loop", "--publish: repeat until Ctrl-C.")] = False
    topics: Annotated[
        list[str] | None, option("--topics PATTERN", "--publish: names with * and ?, repeatable.")
    ] = None
    clock_hz: Annotated[
        float | None,
        option(
            "--clock HZ", "--publish: also publish the time of the bag on /clock.", 0.1, FASTEST_HZ
        ),
    ] = None
    wait_s: Annotated[
        float,
        option("--wait S", "--publish: wait at most so long for subscribers.", 0.0, LONGEST_S),
    ] = 1.0


@bag.command()
@flat
def replay(
    bag: BagArgument,
    playing: Playing,
    rerun: Annotated[
        bool, option("--rerun", "Feed the recorded inputs through the controllers.")
    ] = False,
    publish: Annotated[
        bool, option("--publish", "Publish the messages on their topics, over DDS.")
    ] = False,
    scenario: Annotated[
        Path | None,
        option("--scenario FILE", "--rerun: use this file and not the attached scenario."),
    ] = None,
    plugin: Annotated[
        list[str] | None,
        option(
            "--plugin FILE.py:NAME",
            "--rerun: execute this law, task or controller, which the scenario of the bag names; repeatable.",
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Run a bag through the controllers again (--rerun), or publish it on its topics (--publish).

    --rerun compares every output of every UAV with the recording, byte for byte, and names the first
    difference. Exit codes: 0 equal, or played; 1 different or void; 2 refused; 130 interrupted.
    """
    if rerun == publish:
        raise typer.BadParameter("expected one of --rerun and --publish")
    if publish:
        raise typer.Exit(_publish(bag, playing, json=json))
    from ptnsbc_tools.library import bags as library
    from ptnsbc_tools.replay.rerun import EQUAL

    began = time.monotonic()
    done = library.rerun(bag, scenario=scenario, plugins=plugin or (), progress=True)
    seconds = time.monotonic() - began
    if json:
        console.print_json(done.as_json(seconds))
    else:
        out = console.out()
        out.print(_table(done))
        for line in _lines(done, seconds):
            out.print(line, soft_wrap=True, highlight=False)
    raise typer.Exit(0 if done.verdict == EQUAL else 1)


def _publish(path: Path, playing: Playing, *, json: bool) -> int:
    from ptnsbc_io.bag import read_bag

    bag = read_bag(path)
    with ros.required():
        from ptnsbc_nodes.recording import player
    options = player.PlayOptions(**{**vars(playing), "topics": tuple(playing.topics or ("*",))})
    with console.progress("playing") as advance:
        played = player.play(bag, options, console.say, advance)
    if json:
        console.print_json(vars(played))
    else:
        late = f"at most {1e3 * played.latest_s:.1f} ms late"
        print(f"{played.messages} messages played in {played.rounds} rounds, {late}")
    return _INTERRUPTED if played.interrupted else 0


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
