"""The executables of `ros2 run`."""

from __future__ import annotations

import sys

from .__main__ import importing, main


def player() -> None:
    """Execute `ros2 run phy124_bridge player --ros-args -p clip:=/path/to/clip.safetensors`."""
    _run("node", "main")


def manage() -> None:
    """Execute `ros2 run phy124_bridge managed --ros-args -p clip:=/path/to/clip.safetensors`."""
    _run("managed", "main")


def simulate() -> None:
    """Execute `ros2 run phy124_bridge simulate --ros-args -p source:=photo.png -p scene:=drop`."""
    _run("node", "simulation")


def live() -> int:
    """Execute `ros2 run phy124_bridge live photo.png`, which equals `bridge live photo.png`."""
    return main(["live", *sys.argv[1:]])


def _run(module: str, function: str) -> None:
    with importing(0):
        from importlib import import_module

        from phy124.runtime.streams import steady_streams

        call = getattr(import_module(f".{module}", __package__), function)
    with steady_streams():
        call()
