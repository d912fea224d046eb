"""`ptnsbc verify`: the verdict on a recorded flight."""

from __future__ import annotations

from pathlib import Path

from ptnsbc_tools import result
from ptnsbc_tools.bag_reader import read_recording
from ptnsbc_tools.verdict import Verdict, verdict_on


def verify(
    bag: Path, scenario: Path | None, *, tolerance: float, picture: Path | None, json: bool
) -> Verdict:
    """Read a bag, judge it, print the verdict."""
    recording = read_recording(bag, scenario)
    verdict = verdict_on(recording, tolerance)
    drawn = None
    if picture is not None:
        from ptnsbc_tools.picture import draw

        drawn = draw(recording, picture)
    result.show(verdict, json=json, extra={"picture": drawn})
    return verdict
