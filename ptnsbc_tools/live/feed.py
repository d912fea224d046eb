"""The data of the pages of a live view: the stage, the frames so far, and the newest frame."""

from __future__ import annotations

import json
import threading
from typing import Any

MOST_ROWS = 4000
"""Rows that are kept for a page that joins later: when there are more, every other one is dropped."""
_SPACING_S = 0.1


class Feed:
    """Written by one thread, read by one thread for each page."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._stage: dict[str, Any] = {}
        self._versions = 0  # of the stage
        self._rows: list[list[Any]] = []
        self._spacing_s = _SPACING_S
        self._frame = ""
        self._number = 0  # of frames and answers
        self._answers: list[tuple[int, str]] = []

    def set_stage(self, stage: dict[str, Any]) -> None:
        """Begin anew with another stage; what was flown so far stays."""
        with self._changed:
            self._stage = stage
            self._versions += 1
            self._changed.notify_all()

    def add(self, frame: dict[str, Any]) -> None:
        """The newest picture of the flight (`FlightState.frame`)."""
        with self._changed:
            self._frame = _text({"kind": "frame", **frame})
            self._number += 1
            self._keep(frame)
            self._changed.notify_all()

    def answer(self, text: str) -> None:
        """A line for the people at the pages: what has become of an order."""
        with self._changed:
            self._number += 1
            self._answers = [
                *self._answers[-20:],
                (self._number, _text({"kind": "said", "text": text})),
            ]
            self._changed.notify_all()

    def begin(self) -> tuple[int, int, str]:
        """Number and version of now, and the message with which a page begins: the stage and the flight so far."""
        with self._changed:
            message = {"kind": "stage", "stage": self._stage, "rows": self._rows}
            return self._number, self._versions, _text(message)

    def after(self, number: int, version: int, patience_s: float) -> tuple[int, list[str]] | None:
        """The messages after `number`, waiting so long for one; None when the page is to begin anew."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._number != number or self._versions != version, patience_s
            )
            if self._versions != version:
                return None
            news = [text for at, text in self._answers if at > number]
            if self._number != number and self._frame:
                news.append(self._frame)
            return self._number, news

    def _keep(self, frame: dict[str, Any]) -> None:
        """A row for pages that join later: time, poses and errors of all UAVs, as long as all are known."""
        t, uavs = frame["t"], frame["uavs"]
        if t is None or any(uav["pose"] is None for uav in uavs):
            return
        if self._rows and t - self._rows[-1][0] < self._spacing_s:
            return
        self._rows.append([t, [uav["pose"] for uav in uavs], [uav["error"] for uav in uavs]])
        if len(self._rows) > MOST_ROWS:
            self._rows = self._rows[::2]
            self._spacing_s *= 2.0


def _text(message: dict[str, Any]) -> str:
    return json.dumps(message, allow_nan=False, separators=(",", ":"))
