"""Sweeps: many flights of drawn scenarios, and one row of figures for each UAV and flight."""
