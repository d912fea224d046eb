"""What `fleet` says about a flight whose processes or whose recording did not come out whole."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ptnsbc_tools.commands import fleet

RECORDED = {"messages": 900, "lost": 0, "late": 0}


def flown(**changes: Any) -> Any:
    facts = {
        "processes": (),
        "died": (),
        "interrupted": False,
        "recorded": RECORDED,
        "startup_s": 1.0,
        "flight_s": 7.0,
        "exit_code": 0,
    }
    return SimpleNamespace(**{**facts, **changes})


@pytest.mark.parametrize(
    ("changes", "lines"),
    [
        ({}, []),
        ({"died": ("uav3",)}, ["uav3 ended before its time"]),
        ({"recorded": {**RECORDED, "lost": 7}}, ["the recorder lost 7 of 900 messages"]),
        (
            {"recorded": {**RECORDED, "late": 2}},
            ["2 messages came too late to be sorted: bytes differ between runs"],
        ),
        (
            {"died": ("recorder",), "recorded": {}},
            [
                "recorder ended before its time",
                "the recorder left no count of its messages: the bag may be cut",
            ],
        ),
    ],
)
def test_losses_are_told(changes: dict[str, Any], lines: list[str]) -> None:
    assert list(fleet._losses(flown(**changes))) == lines


@pytest.mark.parametrize(("ended", "code"), [(0, 1), (1, 1), (130, 130)])
def test_an_unreadable_bag_does_not_hide_the_flight(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], ended: int, code: int
) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    wishes = fleet.FleetRequest(lockstep=True, bag=bag, json=True)
    result = flown(exit_code=ended, died=("recorder",), interrupted=ended == 130)
    assert fleet._judged(bag, result, wishes) == code
    out, err = capsys.readouterr()
    assert err.count("\n") == 1
    how = "was interrupted" if ended == 130 else "is over"
    assert err.startswith(f"error: the flight {how} after 7.0 s, but has no verdict: ")
    data = json.loads(out)
    assert (data["verdict"], data["fleet"]["died"]) == (None, ["recorder"])
    assert data["fleet"]["recorded"] == RECORDED
