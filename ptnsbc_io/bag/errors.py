"""The errors of this package."""

from __future__ import annotations

from ptnsbc_core.errors import PtnsbcError


class BagError(PtnsbcError):
    """A bag cannot be written or read; the text names the file, the reason and the way out."""


class DamagedError(BagError):
    """A bag is damaged, and salvage or repair can read around the damage."""
