"""The newest messages of one topic, found by their stamps while a bag streams by."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Callable

from ptnsbc_nodes.wire import Stamped, decode_near, decode_odometry, peek_stamp
from ptnsbc_nodes.wire.cdr import WireError

KEPT_NS = 5_000_000_000
"""How long a message is kept behind the newest; what a step still holds after that is kept by the step."""

_SPARE = 256  # stamps between two clearings

DECODERS: dict[str, Callable[[bytes], Stamped]] = {
    "nav_msgs/msg/Odometry": decode_odometry,
    "sensor_msgs/msg/PointCloud2": decode_near,
}


class Letter:
    """One recorded message; decoded when first asked for."""

    __slots__ = ("_decode", "_decoded", "data")

    def __init__(self, data: bytes, decode: Callable[[bytes], Stamped] | None) -> None:
        self.data = data
        self._decode = decode
        self._decoded: Stamped | None = None

    @property
    def content(self) -> Stamped:
        """Stamp and numbers; WireError when the bytes are no such message."""
        if self._decoded is None:
            if self._decode is None:
                raise WireError("a message that no step is made of")
            self._decoded = self._decode(self.data)
        return self._decoded


class Shelf:
    """Messages of one topic by stamp; several may carry the same."""

    def __init__(self, type_name: str) -> None:
        self._decode = DECODERS.get(type_name)
        self._stamps: list[int] = []  # ascending
        self._letters: dict[int, list[Letter]] = {}

    def put(self, data: bytes) -> None:
        """Keep a message by the stamp in its header."""
        stamp_ns = peek_stamp(data)
        letter = Letter(data, self._decode)
        letters = self._letters.get(stamp_ns)
        if letters is not None:
            letters.append(letter)
            return
        self._letters[stamp_ns] = [letter]
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

    def at(self, stamp_ns: int) -> list[Letter]:
        """Messages with this stamp, in the order they were recorded."""
        return self._letters.get(stamp_ns, [])

    def before(self, stamp_ns: int) -> Letter | None:
        """The newest message stamped before `stamp_ns`."""
        index = bisect_left(self._stamps, stamp_ns)
        return self._letters[self._stamps[index - 1]][-1] if index else None

    def _clear(self) -> None:
        # The newest stays for ever: a sender that has ended is heard no more, but not forgotten.
        keep = bisect_left(self._stamps, self._stamps[-1] - KEPT_NS)
        for stamp_ns in self._stamps[:keep]:
            del self._letters[stamp_ns]
        del self._stamps[:keep]
