"""The newest messages of one topic by stamp, while a bag is read as a stream."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Callable

from ptnsbc_io.wire import Stamped, WireError, decode_near, decode_odometry, peek_stamp

_KEPT_NS = 5_000_000_000  # age behind the newest message at which a message is dropped
_SPARE = 256  # stamps between two clearings
_NONE: list[bytes] = []

_DECODERS: dict[str, Callable[[bytes], Stamped]] = {
    "nav_msgs/msg/Odometry": decode_odometry,
    "sensor_msgs/msg/PointCloud2": decode_near,
}


class TopicBuffer:
    """The newest messages of one topic by stamp; several may have the same stamp."""

    def __init__(self, type_name: str) -> None:
        self._decode = _DECODERS.get(type_name)
        self._stamps: list[int] = []  # ascending
        self._messages: dict[int, list[bytes]] = {}
        self._decoded: dict[int, list[Stamped]] = {}  # as far as a step needed them

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
        """The newest stamp, -1 before the first message."""
        return self._stamps[-1] if self._stamps else -1

    def at(self, stamp_ns: int) -> list[bytes]:
        """Messages with this stamp, in the order of the recording."""
        return self._messages.get(stamp_ns, _NONE)

    def read(self, stamp_ns: int) -> list[Stamped]:
        """Messages with this stamp, decoded; WireError when one cannot be decoded."""
        data = self._messages.get(stamp_ns, _NONE)
        found = self._decoded.get(stamp_ns)
        if found is None or len(found) < len(data):
            if self._decode is None:
                raise WireError("a message that no step is made of")
            found = [self._decode(one) for one in data]
            self._decoded[stamp_ns] = found
        return found

    def before(self, stamp_ns: int) -> Stamped | None:
        """The newest message stamped before `stamp_ns`, decoded."""
        index = bisect_left(self._stamps, stamp_ns)
        return self.read(self._stamps[index - 1])[-1] if index else None

    def _clear(self) -> None:
        # The newest message is always kept: the last state of a sender that has ended still counts.
        keep = bisect_left(self._stamps, self._stamps[-1] - _KEPT_NS)
        for stamp_ns in self._stamps[:keep]:
            del self._messages[stamp_ns]
            self._decoded.pop(stamp_ns, None)
        del self._stamps[:keep]
