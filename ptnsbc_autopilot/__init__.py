"""Test equipment: stand-in flight controllers, real MAVLink on real UDP around the simulated quadrotor. No ROS."""
