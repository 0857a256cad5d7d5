"""Runs the ROS 2 nodes `player` and `simulate`, from reading the parameters to the shutdown.

`start` imports this module in a context in which Ctrl-C ends the process cleanly.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Generator
from contextlib import closing
from itertools import chain
from pathlib import Path
from typing import Any

from phy124.errors import InputError
from phy124.gaussians import Frame
from phy124.io.clip import Clip
from phy124.runtime.failures import failure
from phy124.runtime.signals import handling, interrupt

from .__main__ import ALWAYS
from .cameras import Cameras
from .live import follow, play
from .options import Options
from .parameters import (
    CLIP,
    MAKING,
    RUNNING,
    RUNNING_LIVE,
    SIMULATED,
    declare,
    message_options,
    section_of,
)
from .player import Player
from .ros_node import ros_node
from .sinks.rclpy import RclpySink
from .source import FileWatch, LiveOptions, LiveRun, open_clip
from .topics import PLAYER

CLIP_PARAMETERS = {**CLIP, **RUNNING, **message_options()}
STOPPED_EARLY = 3
"""Exit status of a simulation that stopped early and whose valid frames were saved."""
log = logging.getLogger(__name__)


def main(args: list[str] | None = None) -> None:
    """Run the node `player` with the arguments that follow its name in `ros2 run`."""
    live_through(args, play_clip)


def simulation(args: list[str] | None = None) -> None:
    """Run the node `simulate` with the arguments that follow its name in `ros2 run`."""
    live_through(args, simulate)


def play_clip(node: Any) -> None:
    """Play the clip that the parameters name, until ROS shuts down."""
    chosen = declare(node, CLIP_PARAMETERS)
    path = chosen["clip"]
    watch = FileWatch(path)
    clip, player, options, clock = opened_clip(chosen)
    with (
        Cameras(options, clip.scene, clip) as cameras,
        RclpySink(options, clock=clock, node=node) as sink,
    ):
        log.info("Playing %s. %s", path, sink.audience())
        try:
            look, going = cameras.look, lambda: True
            play(clip, sink, player, look=look, going=going, check=watch.check)
        finally:
            log.info(player.report())


def opened_clip(chosen: dict[str, Any]) -> tuple[Clip, Player, Options, bool]:
    """Return the clip, its player, the message options, and whether to publish /clock.

    The values of `CLIP_PARAMETERS` are removed from `chosen`, the values of all parameters.

    Raises:
        InputError: A value is missing or invalid, or the clip cannot be read.
    """
    path, clock, rate, speed, loop = _take(chosen, "clip", "clock", "rate", "speed", "loop")
    options = _options(chosen)
    _require("clip", path, "/path/to/clip.safetensors")
    clip = open_clip(path)
    return clip, Player(clip.times, rate=rate or None, speed=speed, loop=loop), options, clock


def simulate(node: Any) -> None:
    """Simulate the source that the parameters name; show each frame as soon as it is computed."""
    chosen = declare(node, {**SIMULATED, **RUNNING_LIVE, **message_options()})
    source, clock, speed = _take(chosen, "source", "clock", "speed")
    scene, changes, generator, device, more = _take(
        chosen, "scene", "set", "generator", "device", "more"
    )
    making = {name: section_of(chosen, section) for name, section in MAKING.items()}
    options = _options(chosen)
    _require("source", source, "/path/to/photo.png")
    asked = LiveOptions(True, scene, changes, generator, device, tuple(map(Path, more)), **making)
    run = LiveRun(Path(source), asked)
    Cameras(options, run.scene.data())  # refuses unknown cameras before the object is made
    with (
        RclpySink(options, clock=clock, node=node, running=RUNNING_LIVE) as sink,
        closing(_seen_frames(run, options)) as frames,
    ):
        log.info("Simulating %s, scene %s. %s", source, scene, sink.audience())
        follow(frames, sink, speed=speed)
    if run.stopped is not None:
        log.error("The simulation stopped early; its valid frames were shown. %s", run.stopped)
        raise SystemExit(STOPPED_EARLY)
    log.info("All %d frames were shown.", len(run))


def _seen_frames(run: LiveRun, options: Options) -> Generator[Frame, None, None]:
    """Yield the frames of a run with the pictures of cameras.

    The cameras are created after the first frame is computed, because their positions depend on the
    object's parts, and the scene contains these parts only from then on.
    """
    frames = iter(run)
    for first in frames:
        with Cameras(options, run.scene.data()) as cameras:
            yield from map(cameras.look, chain([first], frames))


def live_through(
    args: list[str] | None, work: Callable[[Any], None], make: Callable[..., Any] | None = None
) -> None:
    """Run a node until it ends; log a user's error as one FATAL line, and exit with status 1.

    Args:
        args: `--ros-args` and the arguments after it.
        work: Function that runs the node until ROS shuts down.
        make: Function that makes the node from its name and namespace. If None, a plain node is
            made.
    """
    refused = None
    try:
        # `ros2 launch` and supervisors send SIGTERM if SIGINT does not end a node.
        with handling(interrupt, always=ALWAYS), ros_node(args, make=make) as node:
            refused = _attempt(node, work)
    except KeyboardInterrupt:
        # Ctrl-C is the usual way to end a node.
        return
    except (ValueError, ImportError) as error:
        # There is no node yet that could log the error.
        refused = failure(error).sentence
        sys.stderr.write(f"[FATAL] [{PLAYER}]: {refused}\n")
    if refused is not None:
        raise SystemExit(1)


def _attempt(node: Any, work: Callable[[Any], None]) -> str | None:
    try:
        work(node)
    except Exception as error:
        # The error message names the remedy, which a traceback would hide.
        refused = failure(error).sentence
        node.get_logger().fatal(refused)
        return refused
    return None


def _take(chosen: dict[str, Any], *names: str) -> list[Any]:
    return [chosen.pop(name) for name in names]


def _require(name: str, value: str, example: str) -> None:
    if not value:
        raise InputError(name, "''", "it is required.", f"For example `-p {name}:={example}`.")


def _options(chosen: dict[str, Any]) -> Options:
    """Return the message options from a node's parameters, in which 0 stands for None."""
    optional = {
        name: chosen.get(name) or None for name in ("max_points", "epoch", "cameras", "draco")
    }
    return Options(**{**chosen, **optional})
