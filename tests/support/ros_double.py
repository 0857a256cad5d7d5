"""A recording double of rclpy 7.1.3 (ROS 2 Jazzy), as far as the bridge uses it.

What it is strict about is what rclpy is strict about: parameters have a static type unless their
descriptor says otherwise, ranges and read-only are enforced, one line of code logs at one level,
`publish` takes the message class or bytes, and nothing works once the context is shut down.
"""

from __future__ import annotations

import enum
import math
import sys
import time
import types
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

POLICIES = ("HISTORY", "DEPTH", "RELIABILITY", "DURABILITY", "LIVELINESS")
MESSAGES = {
    "sensor_msgs": "PointCloud2",
    "tf2_msgs": "TFMessage",
    "visualization_msgs": "MarkerArray",
    "rosgraph_msgs": "Clock",
    "splat_interfaces": "SplatArray",
}


class Type(enum.Enum):
    """rclpy.parameter.Parameter.Type."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9

    @staticmethod
    def of(value: Any) -> Type:
        scalars = {bool: Type.BOOL, int: Type.INTEGER, float: Type.DOUBLE, str: Type.STRING}
        if value is None:
            return Type.NOT_SET
        if type(value) in scalars:
            return scalars[type(value)]
        if not isinstance(value, (list, tuple)):
            raise TypeError(f"The given value is not one of the allowed types '{value}'.")
        arrays = {
            bytes: Type.BYTE_ARRAY,  # the empty list is one, too
            bool: Type.BOOL_ARRAY,
            int: Type.INTEGER_ARRAY,
            float: Type.DOUBLE_ARRAY,
            str: Type.STRING_ARRAY,
        }
        for kind, array in arrays.items():
            if all(type(element) is kind for element in value):
                return array
        raise TypeError(f"The given value is not a list of one of the allowed types '{value}'.")


class ParameterException(Exception):
    """rclpy.exceptions."""

    def __init__(self, text: str, parameters: Any) -> None:
        super().__init__(f"{text}: {parameters}")


class InvalidParameterTypeException(ParameterException):
    def __init__(self, parameter: Parameter, expected: str) -> None:
        super().__init__(
            f"Trying to set parameter '{parameter.name}' to '{parameter.value}' of type "
            f"'{parameter.type_.name}', expecting type '{expected}'",
            parameter.name,
        )


class InvalidParameterValueException(ParameterException):
    def __init__(self, name: str, value: Any, reason: str) -> None:
        super().__init__(f"Invalid parameter value ({value}) for parameter. Reason: {reason}", name)


class ParameterAlreadyDeclaredException(ParameterException):
    pass


class ParameterNotDeclaredException(ParameterException):
    pass


class ParameterImmutableException(ParameterException):
    pass


class Parameter:
    """rclpy.parameter.Parameter."""

    Type = Type

    def __init__(self, name: str, type_: Type | None = None, value: Any = None) -> None:
        self.name, self.value = name, value
        self.type_ = type_ or Type.of(value)


@dataclass
class Range:
    from_value: Any = 0
    to_value: Any = 0
    step: Any = 0


class IntegerRange(Range):
    def __setattr__(self, name: str, value: Any) -> None:
        assert type(value) is int, f"The '{name}' field must be of type 'int'"
        super().__setattr__(name, value)


class FloatingPointRange(Range):
    def __setattr__(self, name: str, value: Any) -> None:
        assert isinstance(value, float) or name == "step", f"The '{name}' field must be a float"
        super().__setattr__(name, value)


@dataclass
class ParameterDescriptor:
    """rcl_interfaces.msg.ParameterDescriptor; of the two ranges at most one may be given."""

    name: str = ""
    type: int = 0
    description: str = ""
    additional_constraints: str = ""
    read_only: bool = False
    dynamic_typing: bool = False
    floating_point_range: list = field(default_factory=list)
    integer_range: list = field(default_factory=list)


@dataclass
class SetParametersResult:
    successful: bool = False
    reason: str = ""


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


@dataclass
class Publisher:
    """rclpy.publisher.Publisher; `unacked` is what subscribers still owe."""

    kind: type
    topic: str
    qos: SimpleNamespace
    overrides: Any
    node: Node
    sent: list = field(default_factory=list)
    subscriptions: int = 0
    acked: bool = True
    waits: list = field(default_factory=list)

    def publish(self, message: Any) -> None:
        self.node.context_must_be_ok("publisher's context is invalid")
        if not isinstance(message, (self.kind, bytes)):
            raise TypeError(f"Expected {self.kind}, got {type(message)}")
        self.sent.append(message)

    def get_subscription_count(self) -> int:
        return self.subscriptions

    def wait_for_all_acked(self, timeout: Any) -> bool:
        self.node.context_must_be_ok("publisher's context is invalid")
        self.waits.append(timeout.seconds)
        if not self.acked:
            time.sleep(timeout.seconds)
        return self.acked


class Node:
    """rclpy.node.Node; class members are what a test sets beforehand."""

    made: list
    parameters: dict
    others: list
    start: Any

    def __init__(self, name: str, *, namespace: str) -> None:
        type(self).start()
        self.name, self.namespace = name, f"/{namespace}"
        self.context = Context()
        self.destroyed = False
        self.publishers: dict[str, Publisher] = {}
        self.services, self.subscriptions = {}, {}
        self.declared: dict[str, Parameter] = {}
        self.descriptors: dict[str, ParameterDescriptor] = {}
        self.actions: dict[str, tuple] = {}
        self.logger = Logger()
        self._checks, self._afters = [], []
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
        value = self.declare_parameter(name, start, ParameterDescriptor(read_only=True)).value
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
        self.subscriptions[topic] = (kind, callback, qos)

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
        given = value if ignore_override else self.parameters.get(name, value)
        parameter = Parameter(name, value=given)
        result = self._set(parameter, descriptor, check_read_only=False)
        if not result.successful:
            if result.reason.startswith("Wrong parameter type"):
                raise InvalidParameterTypeException(parameter, Type(descriptor.type).name)
            raise InvalidParameterValueException(name, given, result.reason)
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
        """Also what `ros2 param set` ends in."""
        for parameter in parameters:
            self.get_parameter(parameter.name)
        return [self._set(p, self.descriptors[p.name], check_read_only=True) for p in parameters]

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

    # What tests do, as another program would.

    def call(self, service: str, **request: Any) -> Any:
        """Call a service, as `ros2 service call` does."""
        response = SimpleNamespace(success=None, message="", paused=None)
        return self.services[service][1](SimpleNamespace(**request), response)

    def param_set(self, name: str, value: Any) -> SetParametersResult:
        """`ros2 param set`."""
        (result,) = self.set_parameters([Parameter(name, value=value)])
        return result


def refusal(parameter, descriptor, check_read_only) -> str:
    """rclpy.node.Node._apply_descriptor."""
    value, kind = parameter.value, parameter.type_
    if check_read_only and descriptor.read_only:
        return f"Trying to set a read-only parameter: {parameter.name}."
    assert not (descriptor.integer_range and descriptor.floating_point_range)
    if descriptor.dynamic_typing:
        descriptor.type = kind.value
    elif kind.value != descriptor.type:
        return f"Wrong parameter type, expected '{Type(descriptor.type)}' got '{kind}'"
    ranges = {Type.INTEGER: descriptor.integer_range, Type.DOUBLE: descriptor.floating_point_range}
    for limits in ranges.get(kind, []):
        ends = (limits.from_value, limits.to_value)
        if not any(math.isclose(value, end) for end in ends) and not ends[0] < value < ends[1]:
            return f"Parameter {parameter.name} out of range Min: {ends[0]}, Max: {ends[1]}"
    return ""


def simulation_result() -> SimpleNamespace:
    return SimpleNamespace(result=0, error_message="")


class SimulateSteps:
    """simulation_interfaces.action.SimulateSteps."""

    class Result:
        def __init__(self) -> None:
            self.result = simulation_result()

    class Feedback:
        def __init__(self) -> None:
            self.completed_steps = self.remaining_steps = 0


class GoalHandle:
    """rclpy.action.server.ServerGoalHandle."""

    def __init__(self, steps: int) -> None:
        self.request = SimpleNamespace(steps=steps)
        self.is_cancel_requested, self.ended = False, ""
        self.feedback: list[tuple[int, int]] = []

    def publish_feedback(self, feedback: Any) -> None:
        assert isinstance(feedback, SimulateSteps.Feedback)
        self.feedback.append((feedback.completed_steps, feedback.remaining_steps))

    def succeed(self) -> None:
        self.ended = "succeeded"

    def abort(self) -> None:
        self.ended = "aborted"

    def canceled(self) -> None:
        assert self.is_cancel_requested
        self.ended = "canceled"


class ActionServer:
    """rclpy.action.ActionServer, whose callback is a coroutine that tests drive."""

    def __init__(self, node, kind, name, execute_callback, *, cancel_callback) -> None:
        node.context_must_be_ok("context is invalid")
        node.actions[name] = (kind, execute_callback, cancel_callback)


class Executor:
    """Runs one scripted callback per spin."""

    script: list

    def __init__(self, *, context: Context) -> None:
        self.nodes, self.stopped, self.context = [], False, context

    def add_node(self, added: Node) -> None:
        self.nodes.append(added)

    def spin_once(self, *, timeout_sec: float) -> None:
        assert 0 <= timeout_sec < math.inf
        time.sleep(min(timeout_sec, 0.001))
        if self.script:
            self.script.pop(0)(self.nodes[0])

    def shutdown(self) -> None:
        self.stopped = True


def install(monkeypatch: Any) -> SimpleNamespace:
    """Put modules in the shape of ROS 2 Jazzy's Python packages in place; returns what is seen."""
    state = SimpleNamespace(log=[], nodes=[], script=[], init=[], at_init=lambda: None)
    Node.made, Node.parameters, Node.others = state.nodes, {}, []
    Node.start = staticmethod(lambda: None)
    Executor.script = state.script

    def module(name: str, **content: Any) -> None:
        made = types.ModuleType(name)
        vars(made).update(content)
        monkeypatch.setitem(sys.modules, name, made)

    def init(*, args=None, signal_handler_options=None) -> None:
        state.log.append("init")
        state.init.append((args, signal_handler_options))
        state.at_init()

    def enums(**members: str) -> dict[str, Any]:
        return {name: enum.Enum(name, words) for name, words in members.items()}

    module("rclpy", init=init, try_shutdown=lambda: state.log.append("shutdown"))
    module("rclpy.node", Node=Node)
    module("rclpy.executors", SingleThreadedExecutor=Executor)
    module("rclpy.qos_overriding_options", QoSOverridingOptions=list)
    module("rclpy.signals", **enums(SignalHandlerOptions="NO ALL SIGINT SIGTERM"))
    module("rclpy.duration", Duration=lambda *, seconds: SimpleNamespace(seconds=seconds))
    module("rclpy.parameter", Parameter=Parameter)
    module("rclpy.exceptions", ParameterException=ParameterException)
    module(
        "rclpy.qos",
        QoSProfile=SimpleNamespace,
        **enums(
            HistoryPolicy="KEEP_LAST KEEP_ALL",
            ReliabilityPolicy="RELIABLE BEST_EFFORT",
            DurabilityPolicy="TRANSIENT_LOCAL VOLATILE",
            QoSPolicyKind=" ".join(POLICIES),
        ),
    )
    for package, name in MESSAGES.items():
        module(f"{package}.msg", **{name: type(name, (), {})})
    names = ("DiagnosticArray", "DiagnosticStatus")
    module("diagnostic_msgs.msg", **{name: type(name, (), {}) for name in names})
    module(
        "rcl_interfaces.msg",
        ParameterDescriptor=ParameterDescriptor,
        FloatingPointRange=FloatingPointRange,
        IntegerRange=IntegerRange,
        SetParametersResult=SetParametersResult,
    )
    names = ("WrenchStamped", "PointStamped")
    module("geometry_msgs.msg", **{name: type(name, (), {}) for name in names})
    kinds = ("GetSimulatorFeatures", "GetSimulationState", "SetSimulationState")
    kinds += ("StepSimulation", "ResetSimulation")
    names = ("String", "Float64")
    module("std_msgs.msg", **{name: type(name, (), {}) for name in names})
    module("simulation_interfaces.srv", **{name: type(name, (), {}) for name in kinds})
    module("simulation_interfaces.action", SimulateSteps=SimulateSteps)
    module("rclpy.action", ActionServer=ActionServer, CancelResponse=SimpleNamespace(ACCEPT=2))
    module("std_srvs.srv", Trigger=type("Trigger", (), {}))
    services = ("Seek", "SetRate", "TogglePaused", "IsPaused", "PlayNext")
    module("rosbag2_interfaces.srv", **{name: type(name, (), {}) for name in services})
    return state
