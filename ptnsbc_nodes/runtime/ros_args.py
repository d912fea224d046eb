"""What rclpy thinks of the arguments after --ros-args, in one line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rclpy.utilities import remove_ros_args

from ptnsbc_core.errors import PtnsbcError


class RosArgumentsError(PtnsbcError):
    """Arguments after --ros-args that rclpy refuses."""


@contextmanager
def ros_errors() -> Iterator[None]:
    """Its complaints inside the `with`, as RosArgumentsError."""
    try:
        yield
    except RuntimeError as error:  # they have no class in common but this
        line = " ".join(str(error).split()).partition(", at /")[0]
        raise RosArgumentsError(line) from None


def without_ros(arguments: Sequence[str]) -> list[str]:
    """The arguments of the program itself.

    Raises:
        RosArgumentsError: ROS does not understand one of the others.
    """
    with ros_errors():
        own: list[str] = remove_ros_args(["program", *arguments])[1:]
    return own
