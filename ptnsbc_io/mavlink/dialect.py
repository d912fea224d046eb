"""The generated dialect `common` of MAVLink 2, imported in one place.

pymavlink chooses a dialect by the environment; this project speaks one, whatever is set.
"""

from __future__ import annotations

import os

os.environ.setdefault("MAVLINK20", "1")

from pymavlink.dialects.v20 import common as mavlink

__all__ = ["mavlink"]
