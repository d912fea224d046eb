"""What every process needs: executor, signals, life cycle, parameters, environment, clocks."""
