"""A stand-in flight controller: real MAVLink on real UDP around the simulated quadrotor. No ROS."""
