"""The packages that a command or a function needs and may lack, and the ROS environment."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from ptnsbc_core.errors import PtnsbcError

INSTALL = "install the extra [ros] or source ROS 2"


class LibraryMissingError(PtnsbcError):
    """A library that a command or a function needs is not installed."""


def library(name: str, what: str, extra: str = "tables") -> Any:
    """The module of a library that `what` needs and our `extra` brings; LibraryMissingError when it is missing."""
    try:
        return import_module(name)
    except ImportError:
        raise LibraryMissingError(
            f'{what}: {name} is not installed: pip install "ptnsbc[{extra}]"'
        ) from None


@contextmanager
def required(advice: str = INSTALL) -> Iterator[None]:
    """Around imports of ROS packages: prepares their environment; a missing package is an error in one line."""
    from ptnsbc_nodes.runtime import environment

    environment.prepare()
    environment.refuse_lonely_middleware()
    try:
        yield
    except ImportError as error:
        package = str(error.name).partition(".")[0]
        raise LibraryMissingError(f"{package} is not installed: {advice}") from None
