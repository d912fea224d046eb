"""The common needs of every process: executor, signals, parameters, environment, clocks."""
