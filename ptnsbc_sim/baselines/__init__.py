"""What the method is compared with (equations.md section 8): other laws on the same plant, estimator and start."""

from ptnsbc_sim.baselines.errors import BaselineError
from ptnsbc_sim.baselines.flights import LAWS, earliest_s, fly, opened
from ptnsbc_sim.baselines.settling import settled_s

__all__ = ["LAWS", "BaselineError", "earliest_s", "fly", "opened", "settled_s"]
