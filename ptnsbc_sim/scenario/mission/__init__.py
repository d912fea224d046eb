"""The parts of a mission: the trajectory of the leader, and the shape of the formation and its changes."""
