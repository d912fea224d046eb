"""Bags: rosbag2 folders with MCAP inside, written and read without ROS."""

from ptnsbc_io.bag.chunk import BagMessage
from ptnsbc_io.bag.errors import BagError
from ptnsbc_io.bag.layout import TopicInfo
from ptnsbc_io.bag.pieces import SplitLimits
from ptnsbc_io.bag.reader import Bag, BagTopic, read_bag
from ptnsbc_io.bag.writer import BagWriter

__all__ = [
    "BagError",
    "TopicInfo",
    "BagWriter",
    "SplitLimits",
    "Bag",
    "BagTopic",
    "BagMessage",
    "read_bag",
]
