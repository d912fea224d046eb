"""`ptnsbc verify`: the verdict on a recorded flight."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from ptnsbc_tools import result
from ptnsbc_tools.reading.bag_reader import OURS, read_recording
from ptnsbc_tools.reading.foreign import Names
from ptnsbc_tools.verdict import Recording, Verdict, verdict_on


@dataclass(frozen=True)
class ReadOptions:
    """What is judged, and how."""

    scenario: Path | None = None
    tolerance: float | None = None  # by default the scenario's
    window_s: float | None = None
    epoch_s: float | None = None
    names: Names = OURS

    def read(self, bag: Path) -> Recording:
        """What is judged of a bag."""
        recording = read_recording(bag, self.scenario, self.names, self.epoch_s)
        return replace(recording, window_s=self.window_s)


def verify(bag: Path, choice: ReadOptions, *, picture: Path | None, json: bool) -> Verdict:
    """Read a bag, judge it, print the verdict."""
    recording = choice.read(bag)
    verdict = verdict_on(recording, choice.tolerance)
    drawn = None
    if picture is not None:
        from ptnsbc_tools.plotting.picture import draw

        drawn = draw(recording, picture, choice.tolerance)
    result.show(verdict, json=json, extra={"picture": drawn})
    return verdict
