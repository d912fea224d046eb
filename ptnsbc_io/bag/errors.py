"""The errors of this package."""

from __future__ import annotations

from ptnsbc_core.errors import PtnsbcError


class BagError(PtnsbcError):
    """A bag that cannot be written or read; the text says which file, why, and the way out."""


class DamagedError(BagError):
    """A bag with damage that salvage or repair can get around."""
