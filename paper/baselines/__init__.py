"""Baselines of the comparison (docs/notes/baselines.md): other laws with the same plant, estimator and start."""

from paper.baselines.flights import LAWS, earliest_s, fly, fly_tuned, opened
from paper.baselines.settling import BaselineError, settled_s

__all__ = ["LAWS", "BaselineError", "earliest_s", "fly", "fly_tuned", "opened", "settled_s"]
