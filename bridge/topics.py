"""Topics of the bridge, their quality of service (QoS), and the services of its nodes.

Topics are reliable and transient local by default, as recommended in REP-2003 for sensor data, so
every subscriber is compatible, and a late subscriber gets the last messages. To add a topic,
declare it here (and in `RECORDED`, if recordings contain it).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

log = logging.getLogger(__name__)
NAMESPACE = "phy124"
STEERED = "live"
"""Name of the node of a steered run."""
Hear = Callable[[Any], object]
"""Function that receives a message, whose members are attributes."""
PLAYER = "player"
"""Name of the node that plays clips."""


@dataclass(frozen=True)
class Topic:
    """A topic, its message type and the quality of service that its publisher offers.

    A name that begins with a tilde is relative to the node, as in ROS 2.
    """

    name: str
    type: str
    depth: int
    """Number of recent messages that are kept for subscribers that connect later."""
    reliable: bool = True
    transient_local: bool = True


class Message(NamedTuple):
    """An encoded message."""

    topic: Topic
    stamp: int
    """Time of the message [ns since 1970]."""
    data: bytes
    """The payload in CDR format, see `cdr`."""


POINTS = Topic("/phy124/points", "sensor_msgs/msg/PointCloud2", depth=5)
ELLIPSOIDS = Topic("/phy124/ellipsoids", "visualization_msgs/msg/MarkerArray", depth=1)
TF_STATIC = Topic("/tf_static", "tf2_msgs/msg/TFMessage", depth=1)
# Subscribers expect the clock to be best effort and volatile, as in ROS.
CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock", depth=1, reliable=False, transient_local=False)
STATUS = Topic("~/status", "diagnostic_msgs/msg/DiagnosticStatus", depth=1)
DIAGNOSTICS = Topic(
    "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", depth=10, transient_local=False
)
COMMAND = Topic("/phy124/command", "std_msgs/msg/String", depth=10, transient_local=False)
"""Topic of commands, to which the bridge subscribes; `live.command` defines the commands."""
TF = Topic("/tf", "tf2_msgs/msg/TFMessage", depth=100, transient_local=False)
PUSH = Topic("~/push", "geometry_msgs/msg/WrenchStamped", depth=64, transient_local=False)
GRAB = Topic("~/grab", "geometry_msgs/msg/PointStamped", depth=10, transient_local=False)
"""Topics to which a steered run subscribes."""
FACTOR = Topic("~/real_time_factor", "std_msgs/msg/Float64", depth=1)
SPLATS = Topic("/phy124/gaussian_splats", "splat_interfaces/msg/SplatArray", depth=1)
IMAGE = "sensor_msgs/msg/Image"
CAMERA = {
    "info": ("camera_info", "sensor_msgs/msg/CameraInfo"),
    "rgb": ("image_raw", IMAGE),
    "depth": ("depth", IMAGE),
    "mask": ("mask", IMAGE),
    "flow": ("flow", IMAGE),
    "jpeg": ("image_raw/compressed", "sensor_msgs/msg/CompressedImage"),
    "h264": ("video", "foxglove_msgs/msg/CompressedVideo"),
}
"""For each kind of camera data, the end of the topic's name and the message type."""
DRACO = Topic("/phy124/points/draco", "point_cloud_interfaces/msg/CompressedPointCloud2", depth=5)
MAIN = (POINTS.name, SPLATS.name)
"""Names of the topic for points and the topic for splats, one of which publishes every frame."""
RECORDED = {topic.name: topic for topic in (TF_STATIC, POINTS, DRACO, ELLIPSOIDS, SPLATS, TF)}
"""Topics that a recording may contain, except the topics of contact forces and cameras.

The clock is not recorded, because it would conflict with the clock of `ros2 bag play --clock`.
"""


def contact(at: str) -> Topic:
    """Return the topic for the force on a wall or for the force between two objects."""
    name = at.replace("-", "_")  # ROS allows no hyphens
    return Topic(
        f"~/contact/{name}", "geometry_msgs/msg/WrenchStamped", depth=10, transient_local=False
    )


def camera_topic(camera: str, kind: str) -> Topic:
    """Return the topic of a camera for a kind of data, such as `rgb` (a key of `CAMERA`)."""
    end, message = CAMERA[kind]
    return Topic(f"~/camera/{camera}/{end}", message, depth=5)


def find_recorded(name: str) -> Topic | None:
    """Return the recorded topic that has this full name, or None."""
    # A camera may have the name `contact`, but the name of a wall contains no slash.
    node, _, camera = name.partition("/camera/")
    camera, _, end = camera.partition("/")
    kinds = {ending: kind for kind, (ending, _) in CAMERA.items()}
    if node.startswith(f"/{NAMESPACE}/") and end in kinds:
        return replace(camera_topic(camera, kinds[end]), name=name)
    node, _, wall = name.partition("/contact/")
    if node.startswith(f"/{NAMESPACE}/") and wall:
        return replace(contact(wall), name=name)
    return RECORDED.get(name)


def full_name(name: str, node: str) -> str:
    """Replace the tilde in the name of a node's topic or service."""
    return name.replace("~", f"/{NAMESPACE}/{node}", 1) if name.startswith("~") else name


@dataclass(frozen=True)
class Service:
    """A service; the thread that calls the sink's `listen` answers its requests."""

    name: str
    type: str
    serve: Callable[[Any], dict[str, Any]]
    """Function that maps a request (with members as attributes) to the members of the response."""


@dataclass(frozen=True)
class Controls:
    """Topics and services that a sink offers in addition to frames."""

    node: str = PLAYER
    published: tuple[Topic, ...] = ()
    """Topics that are published in addition to those of the frames."""
    heard: Mapping[Topic, Hear] = field(default_factory=dict)
    services: tuple[Service, ...] = ()
    steps: Callable[[int], Any] | None = None
    """Function that computes N steps; it returns an iterator that yields once per step."""
    refused: Callable[[str], object] = log.warning
    """Function that receives the error message if an input is refused."""
    clock: bool = False
    patient: bool = True
    """Whether frames wait for slow subscribers; the wait also delays the computation of frames."""
    values: Callable[[], Mapping[str, Any]] = dict
    """Function that returns additional values for the diagnostics."""
