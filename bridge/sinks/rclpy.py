"""RclpySink: frames and services on a ROS 2 machine.

Messages are published as the bytes they already are (`publisher.publish(bytes)`), which skips
rclpy's slow Python fields. Names are relative to the namespace `phy124`, so they can be remapped.
"""

# rclpy comes with ROS 2 and is on no package index, so type checkers do not find it.
# pyright: reportMissingImports=false

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from typing import Any

from phy124.errors import InputError
from phy124.gaussians import Frame

from ..cdr import NANO, encode, time
from ..encoder import FrameEncoder
from ..node import NAMESPACE, ros_node
from ..options import Options
from ..player import Player
from ..topics import CLOCK, COMMAND, Topic
from . import Obey

log = logging.getLogger(__name__)


class RclpySink:
    """Publishes frames through a ROS 2 node and offers its services."""

    monotonic = True

    def __init__(
        self, options: Options | None = None, *, clock: bool = False, node: Any = None
    ) -> None:
        """Ready to enter. Raises InputError if rclpy cannot be imported.

        Args:
            options: How frames become messages.
            clock: Publish /clock with each frame; nobody else may.
            node: The node to use; None makes one and ends it with the sink.
        """
        require_rclpy()
        self._encoder = FrameEncoder((options or Options()).live())
        self._clock, self._given = clock, node
        self._obey: Obey = lambda text: f"{text}: nothing is playing"

    def __enter__(self) -> RclpySink:
        """Offer topics and services."""
        from rclpy.executors import SingleThreadedExecutor

        with ExitStack() as stack:
            self._node = self._given or stack.enter_context(ros_node())
            topics = [*self._encoder.topics, *([CLOCK] if self._clock else [])]
            self._publishers = {topic.name: self._publisher(topic) for topic in topics}
            for message in self._encoder.static():
                self._publish(message.topic, message.data)
            self._listen_to_commands()
            self._executor = SingleThreadedExecutor(context=self._node.context)
            stack.callback(self._executor.shutdown)
            self._executor.add_node(self._node)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop listening; end the node if it is the sink's own."""
        self._stack.close()

    def write(self, frame: Frame) -> None:
        """Publish one frame."""
        if self._clock:
            now = {"clock": time(self._encoder.stamp(frame.time))}
            self._publish(CLOCK, encode(CLOCK.type, now))
        for message in self._encoder.encode(frame):
            self._publish(message.topic, message.data)

    def listen(self, seconds: float, obey: Obey) -> None:
        """Serve ROS for at most so many seconds; raises KeyboardInterrupt when ROS shuts down."""
        self._obey = obey
        with self._until_shutdown():
            self._executor.spin_once(timeout_sec=seconds)

    def show(self, player: Player) -> None:
        """Nothing: there is no ROS topic for it."""
        del player

    def _publish(self, topic: Topic, data: bytes) -> None:
        with self._until_shutdown():
            self._publishers[topic.name].publish(data)

    @contextmanager
    def _until_shutdown(self) -> Iterator[None]:
        """Ctrl-C ends ROS at any moment; what then fails is no error but the end."""
        try:
            yield
        finally:
            if not self._node.context.ok():
                raise KeyboardInterrupt

    def _publisher(self, topic: Topic) -> Any:
        from rclpy.qos import QoSPolicyKind as Kind
        from rclpy.qos_overriding_options import QoSOverridingOptions

        # The default would leave durability out of what users may override.
        kinds = [Kind.HISTORY, Kind.DEPTH, Kind.RELIABILITY, Kind.DURABILITY]
        return self._node.create_publisher(
            message_class(topic.type),
            relative(topic),
            quality(topic),
            qos_overriding_options=QoSOverridingOptions(kinds),
        )

    def _listen_to_commands(self) -> None:
        node, trigger = self._node, import_module("std_srvs.srv").Trigger
        for word in ("play", "pause", "restart"):
            node.create_service(trigger, f"~/{word}", self._trigger(word))
        try:
            seek = import_module("rosbag2_interfaces.srv").Seek
        except ImportError:
            log.warning("rosbag2_interfaces is not installed: there is no service ~/seek.")
        else:
            node.create_service(seek, "~/seek", self._seek)
        heard = message_class(COMMAND.type)
        node.create_subscription(
            heard, relative(COMMAND), lambda message: self._obey(message.data), quality(COMMAND)
        )

    def _trigger(self, word: str) -> Callable[[Any, Any], Any]:
        def serve(request: Any, response: Any) -> Any:
            del request
            response.message = self._obey(word) or ""
            response.success = not response.message
            return response

        return serve

    def _seek(self, request: Any, response: Any) -> Any:
        seconds = request.time.sec + request.time.nanosec / NANO
        response.success = self._obey(f"seek {seconds!r}") is None
        return response


def message_class(name: str) -> Any:
    """The Python class of `package/msg/Name`."""
    package, _, base = name.split("/")
    return getattr(import_module(f"{package}.msg"), base)


def relative(topic: Topic) -> str:
    """Our own topics hang on the node's namespace, the world's are absolute."""
    return topic.name.removeprefix(f"/{NAMESPACE}/")


def quality(topic: Topic) -> Any:
    """The quality of service of a topic as rclpy says it."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    reliable = ReliabilityPolicy.RELIABLE if topic.reliable else ReliabilityPolicy.BEST_EFFORT
    kept = DurabilityPolicy.TRANSIENT_LOCAL if topic.transient_local else DurabilityPolicy.VOLATILE
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=topic.depth, reliability=reliable, durability=kept
    )


def require_rclpy() -> None:
    """Raise InputError if rclpy cannot be imported."""
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        limit = f"rclpy cannot be imported ({error}); it comes with ROS 2, not from PyPI."
        remedy = "Source your ROS 2 installation (`source /opt/ros/jazzy/setup.bash`)."
        raise InputError("backend", "rclpy", limit, remedy) from error
