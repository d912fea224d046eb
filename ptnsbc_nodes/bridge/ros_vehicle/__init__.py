"""Vehicles behind topics and services of ROS 2: the link of a bridge without MAVLink."""
