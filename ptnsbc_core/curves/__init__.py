"""Functions of time that the UAVs follow: the trajectory of the leader, the places of a shape that moves."""
