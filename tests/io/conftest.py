"""rclpy's own serialiser, to compare with."""

from __future__ import annotations

import importlib
import os

import pytest

os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")


TYPES = (
    ("nav_msgs.msg", "Odometry"),
    ("geometry_msgs.msg", "TwistStamped"),
    ("geometry_msgs.msg", "WrenchStamped"),
    ("std_msgs.msg", "Header"),
    ("rosgraph_msgs.msg", "Clock"),
    ("sensor_msgs.msg", "PointCloud2"),
    ("visualization_msgs.msg", "MarkerArray"),
)


@pytest.fixture(scope="session")
def ros():
    """rclpy's serialiser, or skip; with its types loaded, so that no example waits for that."""
    serialization = pytest.importorskip("rclpy.serialization")
    for module, name in TYPES:
        serialization.serialize_message(getattr(importlib.import_module(module), name)())
    return serialization
