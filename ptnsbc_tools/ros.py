"""Commands that need ROS 2 say so where it is not installed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ptnsbc_core.errors import PtnsbcError

WAY_OUT = "install the extra [ros] or source ROS 2"


class RosMissingError(PtnsbcError):
    """A package that a command needs is not installed."""


@contextmanager
def needed(way_out: str = WAY_OUT) -> Iterator[None]:
    """Around the imports of what needs ROS: its environment first, one line when one fails."""
    from ptnsbc_nodes.runtime import environment

    environment.prepare()
    try:
        yield
    except ImportError as error:
        raise RosMissingError(f"{error.name} is not installed: {way_out}") from None
