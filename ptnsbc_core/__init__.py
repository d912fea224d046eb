"""The laws of PTNSBC: pure functions on small arrays, without ROS, MAVLink or I/O."""
