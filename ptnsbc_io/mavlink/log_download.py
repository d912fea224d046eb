"""The newest log of an autopilot, by MAVLink into a file (mavlink.io, Log Transfer)."""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import IO, Any

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.files import replacing
from ptnsbc_io.mavlink.dialect import mavlink
from ptnsbc_io.mavlink.link import AUTOPILOT_COMPONENT, MavlinkLink, companion_heartbeat

WANTED = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_LOG_ENTRY,
        mavlink.MAVLINK_MSG_ID_LOG_DATA,
    }
)
"""Messages that the link of a download decodes."""

_PIECE = 90  # bytes in a LOG_DATA
_WINDOW = 512 * _PIECE  # asked for at once
_AGAIN_S = 0.5  # a question that is not answered by then is asked again
_BEAT_S = 1.0  # between two signs of life
_LOOK_S = 0.05
_EVERY = 0xFFFF


class LogError(PtnsbcError):
    """A log cannot be fetched."""


class LogDownload:
    """One log on its way: call `step` again and again until it is `over`, and `close` at the end.

    The file appears when it is complete. An armed vehicle is asked for nothing.
    """

    def __init__(self, link: MavlinkLink, sysid: int, path: Path, patience_s: float) -> None:
        """`patience_s`: the download fails after so long without an answer."""
        self.link, self.path = link, path
        self.size = self.done = 0  # bytes
        self.over, self.problem = False, ""
        self._target = sysid, AUTOPILOT_COMPONENT
        self._patience_s = patience_s
        self._heard_s = time.monotonic()  # the last message that was waited for
        self._asked_s = self._beaten_s = float("-inf")
        self._work = self._fetch()

    def step(self) -> None:
        """Take in what has arrived, and ask for what is missing."""
        try:
            next(self._work)
        except StopIteration:
            self.over = True
        except PtnsbcError as error:
            self.over, self.problem = True, str(error)

    def close(self) -> None:
        """End the transfer and close the link; an incomplete file is removed."""
        self._work.close()
        self.link.send(mavlink.MAVLink_log_request_end_message(*self._target))
        self.link.close()

    def _fetch(self) -> Generator[None, None, None]:
        while not (beats := self._take(mavlink.MAVLINK_MSG_ID_HEARTBEAT, "no sign of life")):
            yield
        logs: dict[int, Any] = {}
        told, every = 1, mavlink.MAVLink_log_request_list_message(*self._target, 0, _EVERY)
        self._ask(every)
        while len(logs) < told:
            if self._unanswered:
                self._ask(every)
            for entry in self._take(mavlink.MAVLINK_MSG_ID_LOG_ENTRY, "no list of logs"):
                if not entry.num_logs:
                    raise LogError("it has no log")
                logs[entry.id], told = entry, entry.num_logs
            yield
        # ArduPilot says which is the last, of numbers that begin again; PX4 lists files in any order, with their times.
        numbered = beats[0].autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
        log = max(logs.values(), key=lambda one: (one.time_utc, one.id))
        log = logs.get(log.last_log_num, log) if numbered else log
        self.size = log.size
        with replacing(self.path) as part, part.open("wb") as file:
            while self.done < self.size:
                yield from self._fetch_window(log.id, file)

    def _fetch_window(self, number: int, file: IO[bytes]) -> Iterator[None]:
        begin = self.done
        missing = set(range(begin, min(begin + _WINDOW, self.size), _PIECE))
        pieces, last = len(missing), -1
        while missing:
            if (
                self._unanswered or last not in missing
            ):  # the last piece of those that were asked for
                first = last = min(missing)
                while last + _PIECE in missing:
                    last += _PIECE
                span = first, min(last + _PIECE, self.size) - first
                self._ask(mavlink.MAVLink_log_request_data_message(*self._target, number, *span))
            for data in self._take(mavlink.MAVLINK_MSG_ID_LOG_DATA, "no data"):
                if data.id != number or data.ofs not in missing:
                    continue
                file.seek(data.ofs)
                file.write(bytes(data.data[: data.count]))
                missing.remove(data.ofs)
                if data.count < min(_PIECE, self.size - data.ofs):  # it ends before its listed size
                    self.size = data.ofs + data.count
                    missing = {offset for offset in missing if offset < self.size}
            self.done = min(begin + (pieces - len(missing)) * _PIECE, self.size)
            yield

    @property
    def _unanswered(self) -> bool:
        return time.monotonic() - max(self._asked_s, self._heard_s) > _AGAIN_S

    def _ask(self, message: Any) -> None:
        self._asked_s = time.monotonic()
        self.link.send(message)

    def _take(self, kind: int, lack: str) -> list[Any]:
        """The messages of this kind that have arrived; LogError after too long without one."""
        now_s = time.monotonic()
        if now_s - self._beaten_s > _BEAT_S:
            self._beaten_s = now_s
            self.link.send(companion_heartbeat())
        came = []
        for message in self.link.poll(now_s):
            beat = message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT
            if beat and message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED:
                raise LogError("it is armed: expected a vehicle on the ground and disarmed")
            if message.get_msgId() == kind:
                came.append(message)
        if came:
            self._heard_s = now_s
        elif now_s - self._heard_s > self._patience_s:
            raise LogError(
                f"{lack} for {self._patience_s:g} s: expected a vehicle that is switched on, and no bridge"
                " or ground station that talks to it"
            )
        return came


def fetch_logs(downloads: Sequence[LogDownload], advance: Callable[[int, int], object]) -> None:
    """Run downloads beside each other until all are over; `advance` gets the bytes that are there, and all of them."""
    try:
        while going := [each for each in downloads if not each.over]:
            select.select([each.link for each in going], [], [], _LOOK_S)
            for each in going:
                each.step()
            advance(sum(each.done for each in downloads), sum(each.size for each in downloads))
    finally:
        for each in downloads:
            each.close()
