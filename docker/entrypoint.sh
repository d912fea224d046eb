#!/usr/bin/env bash
# Runs a command with ROS and this workspace in its environment.
set -e
source /opt/ros/jazzy/setup.bash
source /opt/ptnsbc/ros/local_setup.bash
exec "$@"
