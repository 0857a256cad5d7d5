"""A ROS 2 node of rclpy, from start to clean shutdown."""

# rclpy comes with ROS 2 and is on no package index, so type checkers do not find it.
# pyright: reportMissingImports=false

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from phy124.errors import InputError

from .controls import PLAYER
from .ros_log import logged_by
from .topics import NAMESPACE


@contextmanager
def ros_node(args: list[str] | None = None, name: str = PLAYER) -> Iterator[Any]:
    """The node /phy124/NAME, from start to clean shutdown; raises InputError."""
    import rclpy
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions

    try:
        # ROS's own handlers would end its context at once, before the last frames have arrived.
        _accepted(lambda: rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO))
        node = _accepted(lambda: Node(name, namespace=NAMESPACE))
        try:
            with logged_by(node):
                yield node
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


def _accepted(start: Callable[[], Any]) -> Any:
    """The result of `start`; if ROS rejects the arguments, raises InputError with one sentence."""
    try:
        return start()
    except (RuntimeError, ValueError) as error:
        said = " ".join(str(error).split())
        limit = f"ROS 2 refuses it ({said})."
        remedy = "Numbers of one list must all have a point or none; see `ros2 run --help`."
        raise InputError("--ros-args", " ".join(sys.argv[1:]), limit, remedy) from error
