"""One flight of one vehicle as a state machine, without ROS and without MAVLink."""
