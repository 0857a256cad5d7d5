"""The executables of `ros2 run`."""

from __future__ import annotations

import sys

from .__main__ import importing, main


def player() -> None:
    """`ros2 run phy124_bridge player --ros-args -p clip:=/path/to/clip.safetensors`."""
    with importing(0):
        from phy124.runtime.streams import steady_streams

        from . import node
    with steady_streams():
        node.main()


def manage() -> None:
    """`ros2 run phy124_bridge managed --ros-args -p clip:=/path/to/clip.safetensors`."""
    with importing(0):
        from phy124.runtime.streams import steady_streams

        from . import managed as node
    with steady_streams():
        node.main()


def simulate() -> None:
    """`ros2 run phy124_bridge simulate --ros-args -p source:=photo.png -p scene:=drop`."""
    with importing(0):
        from phy124.runtime.streams import steady_streams

        from . import node
    with steady_streams():
        node.simulation()


def live() -> int:
    """`ros2 run phy124_bridge live photo.png`: like `bridge live` on the command line."""
    return main(["live", *sys.argv[1:]])
