"""What a baseline refuses."""

from ptnsbc_core.errors import PtnsbcError


class BaselineError(PtnsbcError):
    """A comparison that cannot be flown."""
