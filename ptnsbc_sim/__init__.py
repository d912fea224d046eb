"""Plants, sensors, baselines and the headless swarm."""
