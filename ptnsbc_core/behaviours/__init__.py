"""Behaviours of one UAV: leader tracking, formation and attitude. `nullspace` composes them with clearance."""
