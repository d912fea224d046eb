"""DDS Security of a fleet: what each process may publish and read, and whether the middleware has it."""
