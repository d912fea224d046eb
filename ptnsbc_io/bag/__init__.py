"""Bags: rosbag2 folders with MCAP files, written and read without ROS."""

from ptnsbc_io.bag.mcap_file import BagMessage
from ptnsbc_io.bag.metadata import BagError, TopicDeclaration, declare
from ptnsbc_io.bag.reader import Bag, BagTopic, read_bag
from ptnsbc_io.bag.writer import BagWriter

__all__ = [
    "Bag", "BagError", "BagMessage", "BagTopic", "BagWriter", "TopicDeclaration", "declare",
    "read_bag",
]  # fmt: skip
