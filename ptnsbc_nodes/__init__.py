"""The ROS 2 shells: wire format, bags, recorder, UAV node, bridge."""
