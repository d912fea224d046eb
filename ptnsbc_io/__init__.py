"""Bytes: CDR messages, MCAP bags, MAVLink. Nothing of ROS, nothing of flight."""
