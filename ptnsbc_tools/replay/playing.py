"""`ptnsbc replay --publish`: a bag back onto its topics."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

from ptnsbc_io.bag import read_bag
from ptnsbc_tools import console, ros

_INTERRUPTED = 130


class PlayArguments(NamedTuple):
    """The options of the command; see `ptnsbc_nodes.recording.player.Wishes`."""

    topics: tuple[str, ...]
    rate: float
    start_s: float
    loop: bool
    clock_hz: float | None
    wait_s: float


def publish(path: Path, choice: PlayArguments, *, json: bool) -> int:
    """Play; returns the exit code."""
    bag = read_bag(path)
    with ros.needed():
        from ptnsbc_nodes.recording import player
    wishes = player.PlayOptions(**choice._asdict())
    with console.progress("playing") as advance:
        played = player.play(bag, wishes, _say, advance)
    if json:
        console.print_json(vars(played))
    else:
        late = f"at most {1e3 * played.latest_s:.1f} ms late"
        print(f"{played.messages} messages played in {played.rounds} rounds, {late}")
    return _INTERRUPTED if played.interrupted else 0


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
