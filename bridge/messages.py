"""The ROS 2 messages that the bridge uses: definitions and RIHS01 type hashes of ROS 2 Jazzy.

Constants are left out of the definitions, as they are not part of the wire format. The tests
compare every definition and hash with those of rosbags.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache

SEPARATOR = "=" * 80

DEFINITIONS: dict[str, str] = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/msg/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/msg/String": "string data",
    "diagnostic_msgs/msg/KeyValue": "string key\nstring value",
    "diagnostic_msgs/msg/DiagnosticStatus": (
        "byte level\nstring name\nstring message\nstring hardware_id\n"
        "diagnostic_msgs/KeyValue[] values"
    ),
    "diagnostic_msgs/msg/DiagnosticArray": (
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status"
    ),
    "std_msgs/msg/ColorRGBA": "float32 r\nfloat32 g\nfloat32 b\nfloat32 a",
    "rosgraph_msgs/msg/Clock": "builtin_interfaces/Time clock",
    "sensor_msgs/msg/PointField": "string name\nuint32 offset\nuint8 datatype\nuint32 count",
    "sensor_msgs/msg/PointCloud2": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n"
        "bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense"
    ),
    "sensor_msgs/msg/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/msg/Pose": (
        "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation"
    ),
    "geometry_msgs/msg/Transform": (
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"
    ),
    "geometry_msgs/msg/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "visualization_msgs/msg/UVCoordinate": "float32 u\nfloat32 v",
    "visualization_msgs/msg/MeshFile": "string filename\nuint8[] data",
    "visualization_msgs/msg/Marker": (
        "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\n"
        "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\n"
        "builtin_interfaces/Duration lifetime\nbool frame_locked\ngeometry_msgs/Point[] points\n"
        "std_msgs/ColorRGBA[] colors\nstring texture_resource\n"
        "sensor_msgs/CompressedImage texture\nvisualization_msgs/UVCoordinate[] uv_coordinates\n"
        "string text\nstring mesh_resource\nvisualization_msgs/MeshFile mesh_file\n"
        "bool mesh_use_embedded_materials"
    ),
    "visualization_msgs/msg/MarkerArray": "visualization_msgs/Marker[] markers",
    "rmw_dds_common/msg/Gid": "uint8[16] data",
    "rmw_dds_common/msg/NodeEntitiesInfo": (
        "string<=256 node_namespace\nstring<=256 node_name\n"
        "rmw_dds_common/Gid[] reader_gid_seq\nrmw_dds_common/Gid[] writer_gid_seq"
    ),
    "rmw_dds_common/msg/ParticipantEntitiesInfo": (
        "rmw_dds_common/Gid gid\nrmw_dds_common/NodeEntitiesInfo[] node_entities_info_seq"
    ),
}
"""Type name -> its own lines, in which inner messages are named `package/Name`."""

HASHES: dict[str, str] = {
    "diagnostic_msgs/msg/DiagnosticArray": (
        "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
    ),
    "diagnostic_msgs/msg/DiagnosticStatus": (
        "RIHS01_b0e3e692ea2d54a8af2f4ef1930e81556a2db55216b771f8a7d2724ed47bf0e4"
    ),
    "std_msgs/msg/String": (
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    ),
    "rosgraph_msgs/msg/Clock": (
        "RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564"
    ),
    "sensor_msgs/msg/PointCloud2": (
        "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"
    ),
    "tf2_msgs/msg/TFMessage": (
        "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
    ),
    "visualization_msgs/msg/MarkerArray": (
        "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf"
    ),
    "rmw_dds_common/msg/ParticipantEntitiesInfo": (
        "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"
    ),
}
"""Type of a topic -> its hash (REP-2011)."""


@dataclass(frozen=True)
class Field:
    """One member of a message."""

    name: str
    base: str
    """A primitive such as `uint8`, `string`, or a full message name."""
    length: int | None
    """None: one value; 0: a sequence of any length; otherwise an array of that many values."""
    bound: int | None = None
    """Longest string allowed [bytes]."""


_LINE = re.compile(
    r"(?P<base>[\w/]+)(<=(?P<bound>\d+))?(?P<array>\[(?P<count>\d*)\])? (?P<name>\w+)$"
)


@cache
def fields(name: str) -> tuple[Field, ...]:
    """Members of the message `package/msg/Name`, in wire order; KeyError if it is unknown."""
    return tuple(_field(line) for line in DEFINITIONS[name].splitlines())


def definition(name: str) -> str:
    """The `ros2msg` text of a message and all its inner messages, as in MCAP schemas."""
    blocks = [DEFINITIONS[name]]
    blocks += [f"MSG: {_short(inner)}\n{DEFINITIONS[inner]}" for inner in _inner(name)]
    return f"\n{SEPARATOR}\n".join(blocks) + "\n"


def _field(line: str) -> Field:
    match = _LINE.match(line)
    if match is None:
        raise ValueError(f"not a message member: {line!r}")
    base = match["base"].replace("/", "/msg/")
    length = int(match["count"] or 0) if match["array"] else None
    bound = int(match["bound"]) if match["bound"] else None
    return Field(match["name"], base, length, bound)


def _short(name: str) -> str:
    return name.replace("/msg/", "/")


def _inner(name: str) -> list[str]:
    """All message types inside `name`, each once, depth first in order of appearance."""
    found: list[str] = []
    for member in fields(name):
        if member.base in DEFINITIONS:
            found += [member.base, *_inner(member.base)]
    return list(dict.fromkeys(found))
