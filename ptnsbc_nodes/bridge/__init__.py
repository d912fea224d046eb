"""The bridge between one UAV process and one flight controller."""
