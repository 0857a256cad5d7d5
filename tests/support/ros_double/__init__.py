"""A recording mock of the parts of rclpy 7.1.3 (ROS 2 Jazzy) that the bridge uses.

The mock is as strict as rclpy. Parameters have a static type unless their descriptor states
otherwise, ranges and read-only are enforced, a line of code logs at one level, `publish` takes the
message class or bytes, and nothing works after the context is shut down. As in Jazzy over Cyclone
DDS, there is one callback per spin, queues have a limited depth, and acknowledgements wait for a
heartbeat.
"""

import enum
import math
import sys
import time
import types
from types import SimpleNamespace
from typing import Any

from rosbags.typesys import Stores, get_typestore

from support.ros_double.lifecycle import LifecycleNode, TransitionCallbackReturn
from support.ros_double.node import POLICIES, Context, Node
from support.ros_double.parameters import (
    FloatingPointRange,
    IntegerRange,
    Parameter,
    ParameterDescriptor,
    ParameterException,
    SetParametersResult,
)
from support.ros_double.simulation import ActionServer, GoalHandle, SimulateSteps, simulation_result

__all__ = ["POLICIES", "GoalHandle", "Node", "install", "simulation_result"]

MESSAGES = {
    "sensor_msgs": "PointCloud2 Image CameraInfo CompressedImage",
    "tf2_msgs": "TFMessage",
    "visualization_msgs": "MarkerArray",
    "rosgraph_msgs": "Clock",
    "splat_interfaces": "SplatArray",
}


COST = 0.0003
"""Time that rclpy takes for a callback [s]."""


class Executor:
    """Runs one callback per spin: a scripted callback, or that of the longest queue of messages."""

    script: list

    def __init__(self, *, context: Context) -> None:
        self.nodes, self.stopped, self.context = [], False, context

    def add_node(self, added: Node) -> None:
        self.nodes.append(added)
        added.executor = self

    def spin_once(self, *, timeout_sec: float) -> None:
        assert 0 <= timeout_sec < math.inf
        queues = [each for node in self.nodes for each in node.subscriptions.values()]
        fullest = max(queues, key=lambda each: len(each.waiting), default=None)
        if self.script:
            time.sleep(COST)
            self.script.pop(0)(self.nodes[0])
        elif fullest is not None and fullest.waiting:
            time.sleep(COST)
            fullest.callback(fullest.waiting.popleft())
        else:
            time.sleep(min(timeout_sec, 0.001))

    def shutdown(self) -> None:
        self.stopped = True


def install(monkeypatch: Any) -> SimpleNamespace:
    """Install modules that look like the Python packages of ROS 2 Jazzy; return the record of their
    use."""
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
    transitions = TransitionCallbackReturn
    module("rclpy.lifecycle", LifecycleNode=LifecycleNode, TransitionCallbackReturn=transitions)
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
    for package, names in MESSAGES.items():
        module(f"{package}.msg", **{name: type(name, (), {}) for name in names.split()})
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
    kinds += ("StepSimulation", "ResetSimulation", "GetEntities", "GetEntityInfo")
    kinds += ("GetEntityState", "SetEntityState", "SpawnEntity", "DeleteEntity")
    names = ("String", "Float64")
    module("std_msgs.msg", **{name: type(name, (), {}) for name in names})
    module("simulation_interfaces.srv", **{name: type(name, (), {}) for name in kinds})
    module("simulation_interfaces.action", SimulateSteps=SimulateSteps)
    module("rclpy.action", ActionServer=ActionServer, CancelResponse=SimpleNamespace(ACCEPT=2))
    module("std_srvs.srv", Trigger=type("Trigger", (), {}))
    services = ("Seek", "SetRate", "TogglePaused", "IsPaused", "PlayNext")
    module("rosbag2_interfaces.srv", **{name: type(name, (), {}) for name in services})
    return state


JAZZY = get_typestore(Stores.ROS2_JAZZY)


def decoded(publisher, kind):
    return [JAZZY.deserialize_cdr(data, kind) for data in publisher.sent]


def clouds(made):
    return decoded(made.publishers["points"], "sensor_msgs/msg/PointCloud2")


def statuses(made):
    return decoded(made.publishers["~/status"], "diagnostic_msgs/msg/DiagnosticStatus")


def values(status):
    return {pair.key: pair.value for pair in status.values}
