"""`ptnsbc bag`: show, repair and trim bags."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ptnsbc_tools import console
from ptnsbc_tools.limits import LONGEST_S
from ptnsbc_tools.options import BagArgument, JsonOption, OverwriteOption

if TYPE_CHECKING:
    from ptnsbc_io.bag import Bag
    from ptnsbc_io.bag.repair import Repaired

ANY_WORDS = {"ignore_unknown_options": True, "allow_extra_args": True}

app = typer.Typer(no_args_is_help=True, help="Show, repair or trim bags.")


@app.command()
def info(
    bag: BagArgument,
    check: Annotated[
        bool, typer.Option("--check", help="Read the whole bag and compare every checksum.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Show topics, times, metadata and attachments of a bag; with --check also whether it is complete.

    Opens the remains of a killed recording too. Exit codes: 0, 1 damaged or cut (--check), 2 refused.
    """
    from ptnsbc_io.bag import read_bag
    from ptnsbc_io.bag.reader import find_problems

    found = read_bag(bag, salvage=True)
    wrong = find_problems(found) if check else None
    if json:
        console.print_json(_as_json(found, wrong))
    else:
        _show(found, wrong)
    if wrong:
        raise typer.Exit(1)


@app.command()
def repair(
    bag: Annotated[
        Path,
        typer.Argument(metavar="BAG", help="Bag, the .part of a killed recording, or .mcap file."),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="DIR", help="Write the repaired bag into this folder."
        ),
    ] = None,
    discard: Annotated[
        bool, typer.Option("--discard", help="Remove the damaged bag after the repair.")
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
    else:
        _show_repair(made)


@app.command()
def trim(
    bag: BagArgument,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder of the new bag.")
    ],
    begin: Annotated[
        float,
        typer.Option(
            "--from",
            metavar="S",
            min=0.0,
            max=LONGEST_S,
            help="Keep messages from here on, after the first one.",
        ),
    ] = 0.0,
    end: Annotated[
        float | None,
        typer.Option(
            "--to",
            metavar="S",
            min=0.0,
            max=LONGEST_S,
            help="Keep messages up to here. Default: all.",
        ),
    ] = None,
    overwrite: OverwriteOption = False,
    json: JsonOption = False,
) -> None:
    """Write a span of a bag into a new one; times and bytes of the messages stay.

    What latched topics said before the span, such as the epoch, is kept.
    """
    from ptnsbc_tools.library import bags as library

    count = library.trim(bag, output, begin, end, overwrite=overwrite, progress=True)
    if json:
        console.print_json({"bag": str(output), "messages": count})
    else:
        print(f"{console.counted(count, 'message')}: {output}")


@app.command(hidden=True, context_settings=ANY_WORDS)
def merge() -> None:
    """Refused: other programs merge bags."""
    from ptnsbc_io.bag import BagError

    raise BagError(
        "bag merge: no such command any more: expected `mcap merge A.mcap B.mcap -o C.mcap` (the program mcap), "
        "or `ros2 bag convert` with an -i for each bag"
    )


def _show_repair(made: Repaired) -> None:
    lost = []
    if made.cut:
        lost.append("the end was missing")
    if made.damaged_chunks:
        lost.append(f"{console.counted(made.damaged_chunks, 'damaged chunk')} left out")
    print(
        f"{console.counted(made.messages, 'message')} rescued; {'; '.join(lost) or 'nothing was missing'}"
    )
    print(f"bag: {made.bag}")
    print(f"original: {made.original or 'discarded'}")


def _as_json(bag: Bag, wrong: list[str] | None) -> dict[str, Any]:
    return {
        "files": [str(path) for path, _ in bag.files],
        "start_ns": bag.start_ns,
        "end_ns": bag.end_ns,
        "messages": sum(topic.messages for topic in bag.topics.values()),
        "topics": [
            {"name": topic.name, "type": topic.type, "messages": topic.messages}
            for topic in bag.topics.values()
        ],
        "metadata": dict(bag.metadata),
        "attachments": list(bag.attachments),
        "wrong": wrong,
    }


def _show(bag: Bag, wrong: list[str] | None) -> None:
    from rich.table import Table

    table = Table(title=", ".join(path.name for path, _ in bag.files))
    table.add_column("topic")
    table.add_column("type")
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
    for line in wrong or ():
        console.show(f"wrong: {line}")
    if wrong == []:
        print("whole: every checksum is right")


def _when(stamp_ns: int) -> str:
    """Wall time of a real-time bag, seconds of simulated time otherwise."""
    if stamp_ns < 10**17:  # before 1973: simulated time
        return f"{stamp_ns * 1e-9:.3f} s"
    return f"{datetime.fromtimestamp(stamp_ns * 1e-9, tz=timezone.utc):%Y-%m-%d %H:%M:%S.%f} UTC"
