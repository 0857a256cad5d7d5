"""The topics of the bridge and their quality of service.

They are reliable and transient local, so that every kind of subscriber matches and a late one gets
the last messages (REP-2003 asks publishers of sensor data to be reliable if they can).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

NAMESPACE = "phy124"
STEERED = "live"
"""Name of the node of a run that is steered."""


@dataclass(frozen=True)
class Topic:
    """A topic, its message type and the quality of service its publisher offers.

    A name that begins with a tilde is below that of the node, as in ROS 2.
    """

    name: str
    type: str
    depth: int
    """Number of the last messages that are kept for late subscribers."""
    reliable: bool = True
    transient_local: bool = True


class Message(NamedTuple):
    """One encoded message."""

    topic: Topic
    stamp: int
    """Time of the message [ns since 1970]."""
    data: bytes
    """The payload as CDR, see `cdr`."""


POINTS = Topic("/phy124/points", "sensor_msgs/msg/PointCloud2", depth=5)
ELLIPSOIDS = Topic("/phy124/ellipsoids", "visualization_msgs/msg/MarkerArray", depth=1)
TF_STATIC = Topic("/tf_static", "tf2_msgs/msg/TFMessage", depth=1)
# ROS publishes the clock as best effort and volatile, so that is what subscribers expect.
CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock", depth=1, reliable=False, transient_local=False)
STATUS = Topic("~/status", "diagnostic_msgs/msg/DiagnosticStatus", depth=1)
DIAGNOSTICS = Topic(
    "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", depth=10, transient_local=False
)
COMMAND = Topic("/phy124/command", "std_msgs/msg/String", depth=10, transient_local=False)
"""Subscribed to, not published; the commands are those of `live.command`."""
TF = Topic("/tf", "tf2_msgs/msg/TFMessage", depth=100, transient_local=False)
PUSH = Topic("~/push", "geometry_msgs/msg/WrenchStamped", depth=10, transient_local=False)
GRAB = Topic("~/grab", "geometry_msgs/msg/PointStamped", depth=10, transient_local=False)
"""Subscribed to by a run that is steered."""
FACTOR = Topic("~/real_time_factor", "std_msgs/msg/Float64", depth=1)
SPLATS = Topic("/phy124/gaussian_splats", "splat_interfaces/msg/SplatArray", depth=1)
MAIN = (POINTS.name, SPLATS.name)
"""Names of the topics of which one has the Gaussians of every frame."""
RECORDED = {topic.name: topic for topic in (TF_STATIC, POINTS, ELLIPSOIDS, SPLATS, TF)}
"""Topics in recordings, besides those of `contact`. The clock is not among them, as it would
conflict with that of `ros2 bag play --clock`."""


def contact(at: str) -> Topic:
    """Where the force on a wall, or of an object on another one, is published, by its name."""
    name = at.replace("-", "_")  # ROS takes no hyphens
    return Topic(
        f"~/contact/{name}", "geometry_msgs/msg/WrenchStamped", depth=10, transient_local=False
    )


def recorded(name: str) -> Topic | None:
    """The topic that has this full name in recordings; None if there is none."""
    node, _, wall = name.partition("/contact/")
    if node.startswith(f"/{NAMESPACE}/") and wall:
        return replace(contact(wall), name=name)
    return RECORDED.get(name)


def full_name(name: str, node: str) -> str:
    """The name of a topic or service of a node, without tilde."""
    return name.replace("~", f"/{NAMESPACE}/{node}", 1) if name.startswith("~") else name
