"""Figures over time as plain data, and drawn with Matplotlib."""
