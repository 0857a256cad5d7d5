"""The ROS 2 nodes `player` and `live`: their lives, and the executables of `ros2 run`."""

# rclpy comes with ROS 2 and is on no package index, so type checkers do not find it.
# pyright: reportMissingImports=false

# Only what starts quickly is imported here: Ctrl-C during an import outside of `_live_through`
# would end in a traceback.
from __future__ import annotations

import logging
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

NAMESPACE, NODE = "phy124", "player"
STOPPED_EARLY = 3
"""Exit status of a simulation that kept its good frames but did not reach the end."""
log = logging.getLogger(__name__)


def main(args: list[str] | None = None) -> None:
    """`ros2 run phy124_bridge player --ros-args -p clip:=/path/to/clip.safetensors`."""
    _live_through(args, play_clip)


def live(args: list[str] | None = None) -> None:
    """`ros2 run phy124_bridge live --ros-args -p source:=photo.png -p scene:=drop`."""
    _live_through(args, simulate)


def play_clip(node: Any) -> None:
    """Play the clip the parameters name until ROS shuts down."""
    from .live import play
    from .parameters import CLIP, RUNNING, declare, message_options
    from .player import Player
    from .sinks.rclpy import RclpySink
    from .source import opened

    chosen = declare(node, {**CLIP, **RUNNING, **message_options()})
    path, clock, rate, speed, loop = _taken(chosen, "clip", "clock", "rate", "speed", "loop")
    options = _options(chosen)
    clip = opened(path)
    player = Player(clip.times, rate=rate or None, speed=speed, loop=loop)
    with RclpySink(options, clock=clock, node=node) as sink:
        log.info("Playing %s. %s", path, sink.audience())
        try:
            play(clip, sink, player, stay=True)
        finally:
            log.info(player.report())


def simulate(node: Any) -> None:
    """Simulate what the parameters name, showing each frame as soon as it is there."""
    from pathlib import Path

    from .live import follow
    from .parameters import RUNNING_LIVE, SIMULATED, declare, message_options
    from .sinks.rclpy import RclpySink
    from .source import LiveOptions, LiveRun

    chosen = declare(node, {**SIMULATED, **RUNNING_LIVE, **message_options()})
    source, clock, speed = _taken(chosen, "source", "clock", "speed")
    scene, changes, generator, device = _taken(chosen, "scene", "set", "generator", "device")
    options = _options(chosen)
    asked = LiveOptions(True, scene, changes, generator, device)
    run = LiveRun(Path(source), asked)
    with RclpySink(options, clock=clock, node=node, running=RUNNING_LIVE) as sink:
        log.info("Simulating %s, scene %s. %s", source, scene, sink.audience())
        follow(run, sink, speed=speed)
    if run.stopped is not None:
        log.error("The simulation stopped early; its good frames were shown. %s", run.stopped)
        raise SystemExit(STOPPED_EARLY)
    log.info("All %d frames were shown.", len(run))


@contextmanager
def ros_node(args: list[str] | None = None, name: str = NODE) -> Iterator[Any]:
    """The node /phy124/player, from start to clean shutdown; InputError for bad arguments."""
    import rclpy
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions

    from .ros_log import logged_by

    try:
        # ROS's own handlers would end the context at once, before the last frames have arrived.
        _accepted(lambda: rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO))
        node = _accepted(lambda: Node(name, namespace=NAMESPACE))
        try:
            with logged_by(node):
                yield node
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


def _live_through(args: list[str] | None, work: Callable[[Any], None]) -> None:
    """Run a node to its end; what a user can mend is one line at FATAL and exit status 1."""
    refused = None
    try:
        # `ros2 launch` and supervisors end a node with SIGTERM when SIGINT does not.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        with ros_node(args) as node:
            refused = _attempt(node, work)
    except KeyboardInterrupt:
        # This is how a node is ended.
        return
    except (ValueError, ImportError) as error:
        # There is no node to say it, so far.
        refused = _one_line(error)
        sys.stderr.write(f"[FATAL] [{NODE}]: {refused}\n")
    if refused is not None:
        raise SystemExit(1)


def _attempt(node: Any, work: Callable[[Any], None]) -> str | None:
    """Do the work; returns what was refused, which is logged, or None."""
    try:
        work(node)
    except (ValueError, OSError) as error:
        # InputError and pydantic's errors say what to do; a traceback would bury it.
        refused = _one_line(error)
        node.get_logger().fatal(refused)
        return refused
    return None


def _one_line(error: Exception) -> str:
    from pydantic import ValidationError

    from phy124.scene.refusals import refusal

    from .options import Options

    said = refusal(error, "options", Options) if isinstance(error, ValidationError) else error
    return " ".join(str(said).split())


def _accepted(start: Callable[[], Any]) -> Any:
    """What ROS makes of the arguments; its refusals become one sentence."""
    from phy124.errors import InputError

    try:
        return start()
    except (RuntimeError, ValueError) as error:
        said = " ".join(str(error).split())
        limit = f"ROS 2 refuses it ({said})."
        remedy = "Numbers of one list must all have a point or none; see `ros2 run --help`."
        raise InputError("--ros-args", " ".join(sys.argv[1:]), limit, remedy) from error


def _taken(chosen: dict[str, Any], *names: str) -> list[Any]:
    return [chosen.pop(name) for name in names]


def _options(chosen: dict[str, Any]) -> Any:
    """Options of the messages; 0 stands for what has no other value."""
    from .options import Options

    optional = {name: chosen.get(name) or None for name in ("max_points", "epoch")}
    return Options(**{**chosen, **optional})
