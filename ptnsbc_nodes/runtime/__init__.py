"""The common needs of every process: executor, signals, life cycle, parameters, environment, clocks."""
