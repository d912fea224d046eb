"""`ptnsbc autopilot`."""
