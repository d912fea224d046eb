"""Tolerances of the verdict; in a module of their own, so that `--help` need not load the laws."""

TOLERANCE_M = 0.05
"""Hard limit of the formation error at the deadline."""

SHARE_OF_START = 0.02
"""Share of the start error that widens the band of the settling time."""
