"""The node `managed`: a player that a lifecycle manager configures, activates and shuts down.

    ros2 run phy124_bridge managed --ros-args -p clip:=/path/to/clip.safetensors
    ros2 lifecycle set /phy124/player configure

`configure` opens the clip and offers topics and services, `activate` plays, `deactivate` pauses,
and `cleanup` closes the clip. The next `configure` reads the parameters that cannot be changed
while the node runs.
"""

# rclpy comes with ROS 2 and is in no package index, so type checkers do not find it.
# pyright: reportMissingImports=false

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from phy124.errors import InputError
from phy124.runtime.failures import failure

from .cameras import Cameras
from .live import command, play
from .node import CLIP_PARAMETERS, live_through, opened_clip
from .parameters import convert, declare
from .ros_node import temporary_entities
from .sink import LONGEST_WAIT
from .sinks.rclpy import RclpySink
from .source import FileWatch

INACTIVE = "The node is inactive: activate it first."
RUNNING = ("speed ", "rate ", "loop ")
log = logging.getLogger(__name__)


def main(args: list[str] | None = None) -> None:
    """Run the node `managed` with the arguments that follow its name in `ros2 run`."""
    live_through(args, lambda node: node.work.run(), managed_player)


class Work:
    """The work of a managed node: callbacks change the state, and `run` acts on the state."""

    def __init__(self, node: Any) -> None:
        """Declare the parameters of a node; raise InputError if a value is invalid."""
        self._node = node
        self._sink: RclpySink | None = None
        self._open = ExitStack()
        self._active = self._over = False
        declare(node, CLIP_PARAMETERS, fixed=False)

    def configure(self) -> None:
        """Open the clip, and offer topics and services; raise InputError if this is impossible."""
        node = self._node
        chosen = {
            name: convert(name, node.get_parameter(name).value, parameter)
            for name, parameter in CLIP_PARAMETERS.items()
        }
        watch = FileWatch(chosen["clip"])
        clip, player, options, clock = opened_clip(chosen)
        with ExitStack() as stack:
            stack.enter_context(temporary_entities(node))
            cameras = stack.enter_context(Cameras(options, clip.scene, clip))
            sink = stack.enter_context(RclpySink(options, clock=clock, node=node))
            sink.show(player)
            self._clip, self._player, self._look = clip, player, cameras.look
            self._check = watch.check
            self._sink, self._open = sink, stack.pop_all()

    def activate(self) -> None:
        """Play, starting at the current frame."""
        self._player.play(time.monotonic())
        self._active = True

    def deactivate(self) -> None:
        """Pause; the last frame remains visible."""
        self._player.pause(time.monotonic())
        self._active = False

    def clean_up(self) -> None:
        """Close the clip, and remove the topics and services."""
        self._active, self._sink = False, None
        self._open.close()

    def shut_down(self) -> None:
        """Stop playing, and let `run` return; `run` closes the clip and removes the topics.

        They must outlast this callback, since `play` still uses them.
        """
        if self._active:
            self.deactivate()
        self._over = True

    def run(self) -> None:
        """Until the node or ROS is shut down, play while the node is active, and otherwise wait.

        Raises:
            InputError: Another program wrote into the clip while it was played.
        """
        from rclpy.executors import SingleThreadedExecutor

        node = self._node
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        try:
            while not self._over and node.context.ok():
                if self._sink is None:
                    executor.spin_once(timeout_sec=LONGEST_WAIT)
                elif self._active:
                    play(
                        self._clip,
                        self._sink,
                        self._player,
                        look=self._look,
                        going=lambda: self._active,
                        check=self._check,
                    )
                else:
                    self._sink.listen(LONGEST_WAIT, self._obey_inactive)
        finally:
            self.clean_up()
            executor.shutdown()

    def _obey_inactive(self, text: str) -> str | None:
        if not text.startswith(RUNNING):
            return INACTIVE
        try:
            command(self._player, text, time.monotonic())
        except InputError as error:
            return str(error)
        return None


def managed_player(name: str, *, namespace: str) -> Any:
    """Create the lifecycle node; its attribute `work` runs the node."""
    from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

    def attempt(action: Callable[[], None]) -> Any:
        try:
            action()
        except Exception as error:
            log.error(failure(error).sentence)
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    class ManagedPlayer(LifecycleNode):
        def __init__(self) -> None:
            super().__init__(name, namespace=namespace)
            self.work = Work(self)

        def on_configure(self, state: Any) -> Any:
            return attempt(self.work.configure)

        def on_activate(self, state: Any) -> Any:
            return attempt(self.work.activate)

        def on_deactivate(self, state: Any) -> Any:
            return attempt(self.work.deactivate)

        def on_cleanup(self, state: Any) -> Any:
            return attempt(self.work.clean_up)

        def on_shutdown(self, state: Any) -> Any:
            return attempt(self.work.shut_down)

    return ManagedPlayer()
