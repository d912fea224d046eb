"""The setpoint stream to a flight controller: what is sent at each tick, and its limits."""
