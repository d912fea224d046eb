"""The errors that this project raises on purpose. A message says the value, the expectation and the way out."""

from __future__ import annotations


class PtnsbcError(Exception):
    """Base of all errors that a user can cause; only its text is shown, without a traceback."""


class GainError(PtnsbcError):
    """A gain, deadline, step or limit outside the range in which the laws hold."""


class TopologyError(PtnsbcError):
    """A communication graph that cannot carry the formation."""


class FormationError(PtnsbcError):
    """A desired formation that a task cannot hold (singular, too close, degenerate)."""
