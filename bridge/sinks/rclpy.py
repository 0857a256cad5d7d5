"""RclpySink: publishes frames and offers services through rclpy.

Messages are published as encoded bytes (`publisher.publish(bytes)`), because filling rclpy's Python
fields is slow. Names are relative to the namespace `phy124`, so that they can be remapped.
"""

# rclpy comes with ROS 2 and is in no package index, so type checkers do not find it.
# pyright: reportMissingImports=false

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import Any

from phy124.errors import InputError
from phy124.gaussians import Frame

from ..delivery import Delivery, wait_for_topics
from ..encoder import FrameEncoder
from ..options import Options, live_points
from ..parameters import RUNNING, Parameter, Running, declare
from ..reports import Audience, Reports
from ..ros_node import require_rclpy, ros_node
from ..services import offer_playback, offer_standard
from ..sink import Obey, Playback
from ..topics import COMMAND, NAMESPACE, Controls, Hear, Message, Topic


class RclpySink:
    """Publishes frames through a ROS 2 node and offers the node's services."""

    monotonic = True

    def __init__(
        self,
        options: Options | None = None,
        *,
        clock: bool = False,
        node: Any = None,
        args: list[str] | None = None,
        running: Mapping[str, Parameter] = RUNNING,
        controls: Controls | None = None,
    ) -> None:
        """Prepare the sink; the node starts when the sink's context is entered.

        Args:
            options: Options that define how frames become messages.
            clock: Whether to publish /clock. If so, no other node may publish /clock.
            node: The node to use, with its executor if it has one. If None, create a node that ends
                with the sink.
            args: `--ros-args` and the arguments after it, for the created node.
            running: Parameters that can be changed during playback; missing parameters are
                declared.
            controls: Inputs, topics and services in addition to frames; by default, those of a
                player.

        Raises:
            InputError: rclpy cannot be imported.
        """
        require_rclpy()
        self._encoder = FrameEncoder((options or Options()).live())
        self._controls = controls or Controls(clock=clock)
        self._external, self._args = node, args
        self._parameters, self._running = running, None
        self._playback: Playback | None = None
        self._wishes: list[str] = []  # commands that arrived before the start of playback
        self._obey: Obey = self._wishes.append
        self._values: dict[str, Any] = {}  # state of playback, by name of the parameter
        self._received = 0  # number of messages on all subscribed topics

    def __enter__(self) -> RclpySink:
        from rclpy.executors import SingleThreadedExecutor

        with ExitStack() as stack:
            controls = self._controls
            self._node = self._external or stack.enter_context(ros_node(self._args, controls.node))
            self._name = self._node.get_fully_qualified_name()
            self._reports = Reports(
                self._encoder, self.send, self._audience, controls, node=self._name
            )
            topics = [*self._encoder.topics, *self._reports.topics, *controls.published]
            self._publishers = {
                topic.name: self._publisher(topic) for topic in dict.fromkeys(topics)
            }
            self._delivery = Delivery(
                partial(self._acknowledged_on, self._encoder.main.name),
                self._depth(),
                self._reports.send_due,
                patient=controls.patient,
            )
            for message in self._encoder.static():
                self.send(message)
            offer_playback(self._node, self._ask, lambda: self._playback)
            offer_standard(self._node, controls, self._ask)
            heard: dict[Topic, Hear] = {COMMAND: lambda message: self._obey(message.data)}
            for topic, hear in {**heard, **controls.heard}.items():
                self._node.create_subscription(
                    message_class(topic.type), relative(topic), self._count(hear), quality(topic)
                )
            self._executor = self._node.executor
            if self._executor is None:
                self._executor = SingleThreadedExecutor(context=self._node.context)
                stack.callback(self._executor.shutdown)
                self._executor.add_node(self._node)
            stack.callback(self._say_goodbye)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        """Wait until the last frames have arrived; end the node if the sink created it."""
        if self._running is not None:
            self._running.close()
        self._stack.close()

    @property
    def start(self) -> float:
        """Time at which the clip starts [s since 1970]."""
        return self._encoder.start

    def audience(self) -> str:
        """Return a line that names the node and the receivers of the frames."""
        return (
            f"Node {self._name}; ROS 2's environment variables determine which "
            "machines receive its topics (ros2 node list)."
        )

    def write(self, frame: Frame) -> None:
        """Publish a frame."""
        messages = self._encoder.encode(frame)
        with self._until_shutdown():
            self._delivery.before_frame(len(messages[0].data))
        for message in messages:
            self.send(message)

    def listen(self, seconds: float, obey: Obey) -> bool:
        """Spin the node for up to `seconds`; raise KeyboardInterrupt if ROS shuts down.

        A spin runs at most one callback. Return whether the node received a message.
        """
        self._obey = obey
        while self._wishes:
            obey(self._wishes.pop(0))
        self._reports.send_due()
        before = self._received
        with self._until_shutdown():
            self._executor.spin_once(timeout_sec=min(seconds, self._reports.wait()))
        return self._received > before

    def show(self, playback: Playback) -> None:
        """Publish the status, and update the parameters."""
        self._playback = playback
        values = {"speed": playback.speed, "rate": playback.rate or 0.0, "loop": playback.loop}
        self._values = values
        if self._running is None:
            self._declare({**values, "max_points": self._encoder.options.max_points})
            self._running = Running(self._node, self._parameters, self._apply)
        else:
            self._running.follow(values)
        self._reports.change(playback)

    def _declare(self, values: dict[str, Any]) -> None:
        new = {
            name: replace(parameter, default=values[name])
            for name, parameter in self._parameters.items()
            if not self._node.has_parameter(name)
        }
        for name, value in declare(self._node, new).items():
            self._apply(name, value)

    def _apply(self, name: str, value: Any) -> None:
        if name == "max_points":
            self._encoder.limit(live_points(self._encoder.options.profile, value))
        elif value != self._values[name]:
            word = ("off", "on")[value] if name == "loop" else repr(value)
            self._obey(f"{name} {word}")

    def _ask(self, text: str) -> str | None:
        return self._obey(text)

    def _count(self, hear: Hear) -> Hear:
        def count_and_hear(message: Any) -> None:
            self._received += 1
            hear(message)

        return count_and_hear

    def send(self, message: Message) -> None:
        """Publish a message."""
        with self._until_shutdown():
            self._publishers[message.topic.name].publish(message.data)

    def _acknowledged_on(self, topic: str, seconds: float) -> bool:
        from rclpy.duration import Duration

        return self._publishers[topic].wait_for_all_acked(Duration(seconds=seconds))

    def _depth(self) -> float:
        """Return the number of frames that the writer keeps, with `qos_overrides` applied."""
        profile = self._publishers[self._encoder.main.name].qos_profile
        return math.inf if profile.history.name == "KEEP_ALL" else profile.depth

    def _say_goodbye(self) -> None:
        if self._node.context.ok():
            self._delivery.farewell()
            # In a short run, these messages may be acknowledged after the frames.
            wait_for_topics(self._acknowledged_on, self._publishers)

    def _audience(self) -> Audience:
        publisher = self._publishers[self._encoder.main.name]
        named = [
            f"{space.rstrip('/')}/{name}"
            for name, space in self._node.get_node_names_and_namespaces()
        ]
        namesakes = max(named.count(self._name) - 1, 0)
        return Audience(publisher.get_subscription_count(), self._delivery.lost, namesakes)

    @contextmanager
    def _until_shutdown(self) -> Iterator[None]:
        """Raise KeyboardInterrupt instead of any error that follows a shutdown of ROS."""
        try:
            yield
        finally:
            if not self._node.context.ok():
                raise KeyboardInterrupt

    def _publisher(self, topic: Topic) -> Any:
        from rclpy.exceptions import ParameterException
        from rclpy.qos import QoSPolicyKind as Kind
        from rclpy.qos_overriding_options import QoSOverridingOptions

        # By default, users cannot override the durability.
        kinds = [Kind.HISTORY, Kind.DEPTH, Kind.RELIABILITY, Kind.DURABILITY]
        try:
            return self._node.create_publisher(
                message_class(topic.type),
                relative(topic),
                quality(topic),
                qos_overriding_options=QoSOverridingOptions(kinds),
            )
        except (ParameterException, RuntimeError) as error:
            if not self._node.context.ok():
                raise KeyboardInterrupt from error
            limit = f"ROS 2 refuses these overrides ({error})."
            remedy = "Give reliability, durability and history as words, depth as a whole number."
            raise InputError("qos_overrides", topic.name, limit, remedy) from error


def message_class(name: str) -> Any:
    """Return the Python class of `package/msg/Name`.

    Raises:
        InputError: The package is not installed.
    """
    package, _, base = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), base)
    except ModuleNotFoundError as error:
        limit = f"The ROS 2 package {package} is not installed."
        remedy = f"Install ros-DISTRO-{package.replace('_', '-')}, or leave out what needs it."
        raise InputError("message", name, limit, remedy) from error


def relative(topic: Topic) -> str:
    """Return a topic's name without the namespace of the bridge. Other names remain unchanged."""
    return topic.name.removeprefix(f"/{NAMESPACE}/")


def quality(topic: Topic) -> Any:
    """Return the quality of service of a topic as an rclpy profile."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    reliable = ReliabilityPolicy.RELIABLE if topic.reliable else ReliabilityPolicy.BEST_EFFORT
    kept = DurabilityPolicy.TRANSIENT_LOCAL if topic.transient_local else DurabilityPolicy.VOLATILE
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=topic.depth, reliability=reliable, durability=kept
    )
