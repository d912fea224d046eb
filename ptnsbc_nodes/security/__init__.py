"""DDS Security of a fleet: what each process may publish and read, the keystore, and whether the middleware has it."""
