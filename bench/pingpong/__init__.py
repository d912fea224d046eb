"""The reference of every fleet: the same processes, topics, sizes, QoS and executor, without laws and bag.

A process of this package publishes prebuilt messages with new stamps, and reads the stamps of the messages that it
receives. With `--typed` messages are objects, as in any rclpy program. Without it they are bytes that no process
decodes, and a fleet cannot be faster than that.
"""
