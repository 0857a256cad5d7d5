"""The mock of a node, with the records of its log and its publishers."""

from __future__ import annotations

import enum
import math
import os
import re
import sys
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from support.ros_double.parameters import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    Parameter,
    ParameterAlreadyDeclaredException,
    ParameterDescriptor,
    ParameterImmutableException,
    ParameterNotDeclaredException,
    SetParametersResult,
    Type,
    refusal,
)

POLICIES = ("HISTORY", "DEPTH", "RELIABILITY", "DURABILITY", "LIVELINESS")
HEARTBEAT = 0.1
"""Cyclone's interval between two heartbeats, unless its settings say otherwise [s]."""


def heartbeat() -> float:
    """Return the heartbeat interval [s] in CYCLONEDDS_URI when the first node of a process creates
    the DDS domain."""
    settings = os.environ.get("CYCLONEDDS_URI", "")
    match = re.search(r"<HeartbeatInterval>(\d+) ms<", settings)
    return int(match[1]) / 1000 if match else HEARTBEAT


class Context:
    def __init__(self) -> None:
        self.over = False

    def ok(self) -> bool:
        return not self.over


class Logger:
    """rclpy.impl.rcutils_logger: a line of code may log at one severity only."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []
        self._callers: dict[tuple[str, int, int], str] = {}

    def _log(self, severity: str, text: str) -> None:
        assert isinstance(text, str)
        frame = sys._getframe(2)
        caller = (frame.f_code.co_filename, frame.f_lineno, frame.f_lasti)
        if self._callers.setdefault(caller, severity) != severity:
            raise ValueError("Logger severity cannot be changed between calls.")
        self.lines.append((severity, text))

    def debug(self, text: str) -> None:
        self._log("DEBUG", text)

    def info(self, text: str) -> None:
        self._log("INFO", text)

    def warning(self, text: str) -> None:
        self._log("WARN", text)

    def error(self, text: str) -> None:
        self._log("ERROR", text)

    def fatal(self, text: str) -> None:
        self._log("FATAL", text)


class InvalidHandle(Exception):
    """Stands for rclpy's error of the same name: a destroyed publisher was used."""


@dataclass
class Publisher:
    """rclpy.publisher.Publisher over Cyclone: subscribers acknowledge only at a heartbeat."""

    kind: type
    topic: str
    qos_profile: SimpleNamespace
    overrides: Any
    node: Node
    sent: list = field(default_factory=list)
    subscriptions: int = 0
    acked: bool = True
    """Whether subscribers acknowledge messages."""
    waits: list = field(default_factory=list)
    destroyed: bool = False
    _last: float = -math.inf

    def _must_exist(self) -> None:
        if self.destroyed:
            raise InvalidHandle("cannot use Destroyable because destruction was requested")

    def publish(self, message: Any) -> None:
        self._must_exist()
        self.node.context_must_be_ok("publisher's context is invalid")
        if not isinstance(message, (self.kind, bytes)):
            raise TypeError(f"Expected {self.kind}, got {type(message)}")
        self.sent.append(message)
        self._last = time.monotonic()

    def get_subscription_count(self) -> int:
        return self.subscriptions

    def wait_for_all_acked(self, timeout: Any) -> bool:
        self._must_exist()
        self.node.context_must_be_ok("publisher's context is invalid")
        self.waits.append(timeout.seconds)
        wait = self._unacknowledged()
        time.sleep(min(wait, timeout.seconds))
        return wait <= timeout.seconds

    def _unacknowledged(self) -> float:
        """Return the time until all messages are acknowledged [s]."""
        if not self.acked:
            return math.inf
        if not (self.subscriptions and self.sent):
            return 0.0
        beat = self.node.heartbeat
        return max((math.floor(self._last / beat) + 1) * beat - time.monotonic(), 0.0)


@dataclass
class Subscription:
    """rclpy.subscription.Subscription: if the queue is full, the oldest message is discarded."""

    kind: type
    callback: Callable[[Any], None]
    qos_profile: SimpleNamespace
    waiting: deque = field(init=False)

    def __post_init__(self) -> None:
        self.waiting = deque(maxlen=self.qos_profile.depth)


class ByName(dict):
    """Entities by name for tests; like rclpy's lists, iteration yields the entities."""

    def __iter__(self):
        return iter(self.values())


class Node:
    """rclpy.node.Node; a test sets the class members before it creates a node."""

    made: list
    parameters: dict
    others: list
    start: Any

    def __init__(self, name: str, *, namespace: str) -> None:
        type(self).start()
        self.name, self.namespace = name, f"/{namespace}"
        self.context = Context()
        self.destroyed = False
        self.executor: Any = None
        self.publishers: dict[str, Publisher] = ByName()
        self.services: dict[str, tuple] = ByName()
        self.subscriptions: dict[str, Subscription] = ByName()
        self.heartbeat = heartbeat()
        self.declared: dict[str, Parameter] = {}
        self.descriptors: dict[str, ParameterDescriptor] = {}
        self.actions: dict[str, tuple] = {}
        self.logger = Logger()
        self._before, self._checks, self._afters = [], [], []
        self.made.append(self)

    def context_must_be_ok(self, complaint: str) -> None:
        if not self.context.ok():
            raise RuntimeError(complaint)

    def get_fully_qualified_name(self) -> str:
        return f"{self.namespace}/{self.name}"

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [(self.name, self.namespace), *self.others]

    def get_logger(self) -> Logger:
        return self.logger

    def destroy_node(self) -> None:
        self.destroyed = True

    def create_publisher(self, kind, topic, qos, *, qos_overriding_options) -> Publisher:
        self.context_must_be_ok("context is invalid")
        for policy in qos_overriding_options:
            self._override(topic, qos, policy.name.lower())
        made = Publisher(kind, topic, qos, qos_overriding_options, self)
        self.publishers[topic] = made
        return made

    def _override(self, topic: str, qos: Any, policy: str) -> None:
        default = getattr(qos, policy)
        start = default if isinstance(default, int) else default.name.lower()
        full = topic if topic.startswith("/") else f"{self.namespace}/{topic}"
        full = full.replace("~", self.name)
        name = f"qos_overrides.{full}.publisher.{policy}"
        if not self.has_parameter(name):
            self.declare_parameter(name, start, ParameterDescriptor(read_only=True))
        value = self.get_parameter(name).value
        if isinstance(default, enum.Enum):
            try:
                value = type(default)[value.upper()]
            except KeyError:
                said = f"Unexpected QoS override for policy `{policy}`: `{value}`"
                raise RuntimeError(said) from None
        setattr(qos, policy, value)

    def create_service(self, kind, name, callback) -> None:
        self.context_must_be_ok("context is invalid")
        self.services[name] = (kind, callback)

    def create_subscription(self, kind, topic, callback, qos) -> None:
        self.context_must_be_ok("context is invalid")
        self.subscriptions[topic] = Subscription(kind, callback, qos)

    def destroy_publisher(self, entity) -> None:
        self._destroy(self.publishers, entity)
        entity.destroyed = True

    def destroy_service(self, entity) -> None:
        self._destroy(self.services, entity)

    def destroy_subscription(self, entity) -> None:
        self._destroy(self.subscriptions, entity)

    def _destroy(self, entities: dict, entity: Any) -> None:
        (name,) = [name for name, each in entities.items() if each is entity]
        del entities[name]

    def has_parameter(self, name: str) -> bool:
        return name in self.declared

    def get_parameter(self, name: str) -> Parameter:
        if name not in self.declared:
            raise ParameterNotDeclaredException("Invalid access to undeclared parameter(s)", name)
        return self.declared[name]

    def declare_parameter(self, name, value=None, descriptor=None, ignore_override=False):
        if name in self.declared:
            raise ParameterAlreadyDeclaredException("Parameter(s) already declared", [name])
        descriptor = descriptor or ParameterDescriptor()
        if not descriptor.dynamic_typing:
            descriptor.type = Type.of(value).value
        inputs = value if ignore_override else self.parameters.get(name, value)
        parameter = Parameter(name, value=inputs)
        result = self._set(parameter, descriptor, check_read_only=False)
        if not result.successful:
            if result.reason.startswith("Wrong parameter type"):
                raise InvalidParameterTypeException(parameter, Type(descriptor.type).name)
            raise InvalidParameterValueException(name, inputs, result.reason)
        return self.declared[name]

    def set_descriptor(self, name, descriptor, alternative_value=None) -> None:
        if self.descriptors[name].read_only:
            raise ParameterImmutableException("Attempted to modify read-only parameter", name)
        assert alternative_value is None
        parameter = self.get_parameter(name)
        result = self._set(parameter, descriptor, check_read_only=False)
        if not result.successful:
            raise InvalidParameterValueException(name, parameter.value, result.reason)

    def set_parameters(self, parameters: list[Parameter]) -> list[SetParametersResult]:
        """Set parameters; `ros2 param set` also calls this method."""
        for before in self._before:
            parameters = before(parameters)
        for parameter in parameters:
            self.get_parameter(parameter.name)
        return [self._set(p, self.descriptors[p.name], check_read_only=True) for p in parameters]

    def add_pre_set_parameters_callback(self, callback) -> None:
        self._before.insert(0, callback)

    def remove_pre_set_parameters_callback(self, callback) -> None:
        self._before.remove(callback)

    def remove_on_set_parameters_callback(self, callback) -> None:
        self._checks.remove(callback)

    def remove_post_set_parameters_callback(self, callback) -> None:
        self._afters.remove(callback)

    def add_on_set_parameters_callback(self, callback) -> None:
        self._checks.insert(0, callback)

    def add_post_set_parameters_callback(self, callback) -> None:
        self._afters.insert(0, callback)

    def _set(self, parameter, descriptor, *, check_read_only) -> SetParametersResult:
        reason = refusal(parameter, descriptor, check_read_only)
        if reason:
            return SetParametersResult(False, reason)
        for check in self._checks:
            result = check([parameter])
            if not result.successful:
                return result
        self.descriptors[parameter.name] = descriptor
        self.declared[parameter.name] = parameter
        for after in self._afters:
            after([parameter])
        return SetParametersResult(True)

    # Methods for tests, which act like another program.

    def hear(self, topic: str, *messages: Any) -> None:
        """Put messages into the queue of a subscription."""
        self.subscriptions[topic].waiting.extend(messages)

    def call(self, service: str, **request: Any) -> Any:
        """Call a service, as `ros2 service call` does."""
        response = SimpleNamespace(success=None, message="", paused=None)
        return self.services[service][1](SimpleNamespace(**request), response)

    def param_set(self, name: str, value: Any) -> SetParametersResult:
        """`ros2 param set`."""
        (result,) = self.set_parameters([Parameter(name, value=value)])
        return result
