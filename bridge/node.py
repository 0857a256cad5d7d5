"""The ROS 2 node `player`: its life, its parameters and the executable of `ros2 run`."""

# rclpy comes with ROS 2 and is on no package index, so type checkers do not find it.
# pyright: reportMissingImports=false

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from phy124.clip import Clip

from .live import play
from .options import Options
from .player import Player

NAMESPACE, NODE = "phy124", "player"
PLAYBACK = {"clip": "", "rate": 0.0, "speed": 1.0, "loop": True, "clock": False}
"""Parameters beside those of Options; a rate of 0 shows every frame."""
OPTIONAL = {"max_points": 0, "epoch": 0.0, "rate": 0.0}
"""ROS parameters have no None: these values stand for it."""
log = logging.getLogger(__name__)


@contextmanager
def ros_node(args: list[str] | None = None) -> Iterator[Any]:
    """The node /phy124/player, from start to clean shutdown."""
    import rclpy
    from rclpy.node import Node

    rclpy.init(args=args)
    try:
        node = Node(NODE, namespace=NAMESPACE)
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        # Ctrl-C has shut ROS down already.
        rclpy.try_shutdown()


def parameters(node: Any) -> dict[str, Any]:
    """Declare all parameters, fixed once the node runs, and read them."""
    from rcl_interfaces.msg import ParameterDescriptor

    fields = Options.model_fields
    defaults = PLAYBACK | {name: field.default for name, field in fields.items()} | OPTIONAL
    values = {}
    for name, default in defaults.items():
        about = (fields[name].description if name in fields else "") or ""
        start = list(default) if isinstance(default, tuple) else default
        node.declare_parameter(name, start, ParameterDescriptor(description=about, read_only=True))
        value = node.get_parameter(name).value
        values[name] = None if name in OPTIONAL and not value else value
    return values


def main(args: list[str] | None = None) -> None:
    """`ros2 run phy124_bridge player --ros-args -p clip:=/path/to/clip.safetensors`."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    with ros_node(args) as node:
        try:
            run(node)
        except KeyboardInterrupt:
            # This is how a node is ended.
            return
        except ValueError as error:
            # InputError and pydantic's errors say what to do; a traceback would bury it.
            node.get_logger().fatal(str(error))
            raise SystemExit(1) from error


def run(node: Any) -> None:
    """Play the clip the parameters name until ROS shuts down."""
    from .sinks.rclpy import RclpySink

    chosen = parameters(node)
    path, rate, speed, loop, clock = (chosen.pop(name) for name in PLAYBACK)
    clip = Clip.load(path)
    player = Player(clip.times, rate=rate, speed=speed, loop=loop)
    with RclpySink(Options(**chosen), clock=clock, node=node) as sink:
        try:
            play(clip, sink, player, stay=True)
        finally:
            log.info(player.report())
