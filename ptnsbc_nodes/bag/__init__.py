"""Bags: rosbag2 folders with MCAP inside, written and read without ROS."""

from ptnsbc_nodes.bag.chunk import BagMessage
from ptnsbc_nodes.bag.errors import BagError
from ptnsbc_nodes.bag.layout import TopicInfo
from ptnsbc_nodes.bag.pieces import Limits
from ptnsbc_nodes.bag.reader import Bag, BagTopic, read_bag
from ptnsbc_nodes.bag.writer import BagWriter

__all__ = [
    "BagError",
    "TopicInfo",
    "BagWriter",
    "Limits",
    "Bag",
    "BagTopic",
    "BagMessage",
    "read_bag",
]
