"""`ptnsbc params`: a scenario as a ROS parameter file."""
