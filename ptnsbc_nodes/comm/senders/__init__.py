"""The sender of a message: the GID of its publisher, and whether it is the first publisher of its topic."""
