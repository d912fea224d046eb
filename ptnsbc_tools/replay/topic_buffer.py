"""The newest messages of one topic, found by their stamps while a bag streams by."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Callable

from ptnsbc_io.wire import Stamped, decode_near, decode_odometry, peek_stamp
from ptnsbc_io.wire.cdr import WireError

KEPT_NS = 5_000_000_000
"""How long a message is kept behind the newest; what a step still holds after that is kept by the step."""

_SPARE = 256  # stamps between two clearings

_NONE: list[bytes] = []

DECODERS: dict[str, Callable[[bytes], Stamped]] = {
    "nav_msgs/msg/Odometry": decode_odometry,
    "sensor_msgs/msg/PointCloud2": decode_near,
}


class TopicBuffer:
    """Messages of one topic by stamp; several may carry the same."""

    def __init__(self, type_name: str) -> None:
        self._decode = DECODERS.get(type_name)
        self._stamps: list[int] = []  # ascending
        self._messages: dict[int, list[bytes]] = {}
        self._read: dict[int, list[Stamped]] = {}  # decoded, as far as somebody asked

    def put(self, data: bytes) -> None:
        """Keep a message by the stamp in its header."""
        stamp_ns = peek_stamp(data)
        messages = self._messages.get(stamp_ns)
        if messages is not None:
            messages.append(data)
            return
        self._messages[stamp_ns] = [data]
        stamps = self._stamps
        if not stamps or stamp_ns > stamps[-1]:
            stamps.append(stamp_ns)
        else:
            insort(stamps, stamp_ns)
        if len(stamps) % _SPARE == 0:
            self._clear()

    @property
    def newest_ns(self) -> int:
        """The newest stamp of all, -1 before the first."""
        return self._stamps[-1] if self._stamps else -1

    def at(self, stamp_ns: int) -> list[bytes]:
        """Messages with this stamp, in the order they were recorded."""
        return self._messages.get(stamp_ns, _NONE)

    def read(self, stamp_ns: int) -> list[Stamped]:
        """The same, decoded; WireError when one is no such message."""
        data = self._messages.get(stamp_ns, _NONE)
        found = self._read.get(stamp_ns)
        if found is None or len(found) < len(data):
            if self._decode is None:
                raise WireError("a message that no step is made of")
            self._read[stamp_ns] = found = [self._decode(one) for one in data]
        return found

    def before(self, stamp_ns: int) -> Stamped | None:
        """The newest message stamped before `stamp_ns`, decoded."""
        index = bisect_left(self._stamps, stamp_ns)
        return self.read(self._stamps[index - 1])[-1] if index else None

    def _clear(self) -> None:
        # The newest stays for ever: a sender that has ended is heard no more, but not forgotten.
        keep = bisect_left(self._stamps, self._stamps[-1] - KEPT_NS)
        for stamp_ns in self._stamps[:keep]:
            del self._messages[stamp_ns]
            self._read.pop(stamp_ns, None)
        del self._stamps[:keep]
