"""Messages with the GID of their publisher.

The middleware tells the GID of each message, and rclpy of Jazzy leaves it out. So messages are taken from rcl itself,
by the call that rclpy makes, right before rclpy makes it. A message that arrives between the two calls comes
without a GID, but with its number: each publisher counts its messages from 1. Where the structures of rcl are not those
that are written here, all messages come so.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable
from contextlib import suppress
from ctypes import POINTER, byref, c_int, c_int64, c_size_t, c_uint8, c_uint64, c_void_p
from functools import cache
from typing import Any, NamedTuple

from rclpy.exceptions import InvalidHandle
from rclpy.subscription import Subscription
from rclpy.utilities import get_rmw_implementation_identifier


class Taken(NamedTuple):
    """A serialised message."""

    data: bytes
    gid: bytes  # of its publisher, 16 bytes; empty when it is not known
    number: int  # by which the publisher counts its messages


OnMessage = Callable[[Taken], None]

_FIRST_BYTES = 1024  # of the buffer, which grows with the messages
_MOST_BYTES = 1 << 20  # a buffer that has grown beyond this is freed again


class _Allocator(ctypes.Structure):
    """rcutils_allocator_t."""

    _fields_ = [(f"word{k}", c_void_p) for k in range(5)]


class _SerializedMessage(ctypes.Structure):
    """rcl_serialized_message_t."""

    _fields_ = [
        ("buffer", c_void_p),
        ("length", c_size_t),
        ("capacity", c_size_t),
        ("allocator", _Allocator),
    ]


class _MessageInfo(ctypes.Structure):
    """rmw_message_info_t, with room for what a later one may hold."""

    _fields_ = [
        ("source_timestamp", c_int64),
        ("received_timestamp", c_int64),
        ("publication_sequence_number", c_uint64),
        ("reception_sequence_number", c_uint64),
        ("implementation", c_void_p),
        ("gid", c_uint8 * 16),
        ("room", c_uint8 * 256),
    ]


class _Rcl(NamedTuple):
    """The functions of rcl, rcutils and the middleware that take a message; rclpy has loaded these libraries."""

    take: Callable[..., int]
    begin: Callable[..., int]
    end: Callable[..., int]
    allocator: _Allocator
    implementation: int  # address of the name of the middleware, which every GID bears


@cache
def _rcl() -> _Rcl | None:
    """None where a library is missing. The calls keep Python's lock, as those of rclpy do."""
    try:
        rcl, rcutils, rmw = (
            ctypes.PyDLL(f"lib{name}.so")
            for name in ("rcl", "rcutils", get_rmw_implementation_identifier())
        )
        take, begin = rcl.rcl_take_serialized_message, rcutils.rcutils_uint8_array_init
        end, name = rcutils.rcutils_uint8_array_fini, rmw.rmw_get_implementation_identifier
        allocator = rcutils.rcutils_get_default_allocator
    except (OSError, AttributeError):
        return None
    take.argtypes, take.restype = [c_void_p] * 4, c_int
    begin.argtypes = [POINTER(_SerializedMessage), c_size_t, POINTER(_Allocator)]
    end.argtypes = [POINTER(_SerializedMessage)]
    name.restype, allocator.restype = c_void_p, _Allocator
    return _Rcl(take, begin, end, allocator(), name())


class _Taker:
    """Takes the messages of one subscription."""

    def __init__(self, rcl: _Rcl, subscription: int) -> None:
        """`subscription`: address of its rcl_subscription_t."""
        self._rcl = rcl
        self._subscription = subscription
        self._message, self._info = _SerializedMessage(), _MessageInfo()
        self._addresses = ctypes.addressof(self._message), ctypes.addressof(self._info)
        self._gid = memoryview(self._info.gid).cast("B")
        rcl.begin(byref(self._message), _FIRST_BYTES, byref(rcl.allocator))
        weakref.finalize(self, rcl.end, byref(self._message))

    def take(self) -> Taken | None:
        """The next message, if there is one."""
        if self._rcl.take(self._subscription, *self._addresses, None):
            return None
        message, info = self._message, self._info
        data = ctypes.string_at(message.buffer, message.length)
        if message.capacity > _MOST_BYTES:
            self._rcl.end(byref(message))
            self._rcl.begin(byref(message), _FIRST_BYTES, byref(self._rcl.allocator))
        known = info.implementation == self._rcl.implementation
        return Taken(data, self._gid.tobytes() if known else b"", info.publication_sequence_number)


class GidSubscription(Subscription):
    """A raw subscription that hands its messages over with the GIDs of their publishers."""

    door: Callable[[bytes], None]
    by_gid: bool
    """False: rclpy takes the messages, which costs less, and they come without GIDs."""
    _taker: _Taker | None
    _on_message: OnMessage

    @property
    def raw(self) -> bool:
        """True: messages stay serialised.

        The executors of rclpy ask for this right before they take a message. All that wait are taken here.
        """
        if self.by_gid and self._taker is not None:
            # A subscription that is being destroyed may have a last event.
            with suppress(InvalidHandle), self.handle:
                self._take_all(self._taker)
        return True

    def on_late(self, data: Any, info: Any = None) -> None:
        """The EventsExecutor of Jazzy passes message and information as one argument, others as two."""
        if info is None:
            data, info = data
        self._on_message(Taken(data, b"", info["publication_sequence_number"] or 0))

    def _take_all(self, taker: _Taker) -> None:
        # No more than the queue holds: what arrives meanwhile has an event of its own.
        for _ in range(self.qos_profile.depth):
            taken = taker.take()
            if taken is None:
                return
            self._on_message(taken)
            if not taken.gid:
                self._taker = None
                return


def tell_gids(subscription: Subscription, on_message: OnMessage) -> GidSubscription:
    """Hand the messages of a raw subscription to `on_message`, and no more to its callback."""
    rcl = _rcl()
    subscription.door = subscription.callback
    subscription._taker = None if rcl is None else _Taker(rcl, subscription.handle.pointer)
    subscription._on_message = on_message
    subscription.by_gid = True
    subscription.__class__ = GidSubscription
    # Kept in an attribute, because the EventsExecutor holds no reference of its own.
    subscription._callback = subscription.on_late
    subscription._callback_type = Subscription.CallbackType.WithMessageInfo
    heard: GidSubscription = subscription
    return heard
