"""A ROS domain that no other fleet on this host uses."""

from __future__ import annotations

import errno
import os
import random
import socket
from collections.abc import Iterator
from contextlib import contextmanager

from ptnsbc_core.errors import PtnsbcError

_DOMAINS = range(1, 102)  # above, the ports reach into those the system hands out
_FIRST_PARTICIPANTS = 3


class DomainError(PtnsbcError):
    """No usable ROS domain."""


@contextmanager
def reserved_domain() -> Iterator[int]:
    """The user's ROS_DOMAIN_ID, or a free domain that stays ours inside the `with`."""
    given = os.environ.get("ROS_DOMAIN_ID")
    if given is not None:
        if not given.isdecimal():
            raise DomainError(f"ROS_DOMAIN_ID={given!r}: expected a number from 0 to 101")
        yield int(given)
        return
    lock, domain = _lock()
    with lock:
        yield domain


def _lock() -> tuple[socket.socket, int]:
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        # An abstract socket: the kernel frees it however this process ends.
        lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            lock.bind(f"\0ptnsbc-domain-{domain}")
        except OSError as error:
            lock.close()
            if error.errno != errno.EADDRINUSE:
                raise
            continue
        if _unused(domain):
            return lock, domain
        lock.close()
    raise DomainError("every ROS domain from 1 to 101 is in use: set ROS_DOMAIN_ID")


def _unused(domain: int) -> bool:
    """Whether nobody listens where the first participants of the domain would."""
    for participant in range(_FIRST_PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + 10 + 2 * participant))
            except OSError:
                return False
    return True
