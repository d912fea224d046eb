"""Libraries that are not needed for flying: loaded at their first use, with a clear word when they are missing."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ptnsbc_core.errors import PtnsbcError


class LibraryMissingError(PtnsbcError):
    """A library that a function needs is not installed."""


def required(name: str, what: str, extra: str = "tables") -> Any:
    """The module of a library that `what` needs and our `extra` brings; LibraryMissingError when it is missing."""
    try:
        return import_module(name)
    except ImportError:
        raise LibraryMissingError(
            f'{what}: {name} is not installed: pip install "ptnsbc[{extra}]"'
        ) from None
