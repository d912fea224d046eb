"""What a mission is made of: the trajectory of the leader, and the shape of the formation and its changes."""
