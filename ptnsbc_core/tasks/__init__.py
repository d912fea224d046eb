"""The clearance task, the formation tasks and their table, and the distances of bodies."""
