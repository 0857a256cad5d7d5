"""Definitions of the ROS 2 messages that the bridge uses, and the RIHS01 hashes of their types.

Constants are omitted from the definitions, because they are not part of the wire format. The tests
compare the definitions and hashes of ROS 2's own messages with the package rosbags. For the
messages of four other packages, only names and types are defined: simulation_interfaces 2.1.0,
splat_interfaces (of RVizSplat), foxglove_msgs and point_cloud_interfaces.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass
from functools import cache
from typing import Any

SEPARATOR = "=" * 80

NOTHING = "uint8 structure_needs_at_least_one_member"
"""Dummy member that ROS 2 adds to a message without members."""
RESULT = "simulation_interfaces/Result result"

DEFINITIONS: dict[str, str] = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/msg/Duration": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/msg/String": "string data",
    "std_msgs/msg/Float64": "float64 data",
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
    "sensor_msgs/msg/Image": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
        "uint8 is_bigendian\nuint32 step\nuint8[] data"
    ),
    "sensor_msgs/msg/RegionOfInterest": (
        "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify"
    ),
    "sensor_msgs/msg/CameraInfo": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\n"
        "float64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\n"
        "uint32 binning_y\nsensor_msgs/RegionOfInterest roi"
    ),
    "point_cloud_interfaces/msg/CompressedPointCloud2": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n"
        "bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] compressed_data\n"
        "bool is_dense\nstring format"
    ),
    "foxglove_msgs/msg/CompressedVideo": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format"
    ),
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
    "geometry_msgs/msg/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/msg/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    "geometry_msgs/msg/PointStamped": "std_msgs/Header header\ngeometry_msgs/Point point",
    "geometry_msgs/msg/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "splat_interfaces/msg/Splat": (
        "geometry_msgs/PoseWithCovarianceStamped pose\nuint8 opacity\nuint8 harmonics_deg\n"
        "float32[] spherical_harmonics"
    ),
    "splat_interfaces/msg/SplatArray": "splat_interfaces/Splat[] splats",
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
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/msg/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/msg/Accel": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "simulation_interfaces/msg/Bounds": "uint8 type\ngeometry_msgs/Vector3[] points",
    "simulation_interfaces/msg/EntityCategory": "uint8 category",
    "simulation_interfaces/msg/TagsFilter": "string[] tags\nuint8 filter_mode",
    "simulation_interfaces/msg/EntityFilters": (
        "string filter\nsimulation_interfaces/EntityCategory[] categories\n"
        "simulation_interfaces/TagsFilter tags\nsimulation_interfaces/Bounds bounds"
    ),
    "simulation_interfaces/msg/EntityInfo": (
        "simulation_interfaces/EntityCategory category\nstring description\nstring[] tags"
    ),
    "simulation_interfaces/msg/EntityState": (
        "std_msgs/Header header\ngeometry_msgs/Pose pose\ngeometry_msgs/Twist twist\n"
        "geometry_msgs/Accel acceleration"
    ),
    "simulation_interfaces/srv/GetEntities_Request": "simulation_interfaces/EntityFilters filters",
    "simulation_interfaces/srv/GetEntities_Response": f"{RESULT}\nstring[] entities",
    "simulation_interfaces/srv/GetEntityInfo_Request": "string entity",
    "simulation_interfaces/srv/GetEntityInfo_Response": (
        f"{RESULT}\nsimulation_interfaces/EntityInfo info"
    ),
    "simulation_interfaces/srv/GetEntityState_Request": "string entity",
    "simulation_interfaces/srv/GetEntityState_Response": (
        f"{RESULT}\nsimulation_interfaces/EntityState state"
    ),
    # Version 1.5, which Jazzy uses. Version 2.1 has additional flags.
    "simulation_interfaces/srv/SetEntityState_Request": (
        "string entity\nsimulation_interfaces/EntityState state"
    ),
    "simulation_interfaces/srv/SetEntityState_Response": RESULT,
    "simulation_interfaces/srv/SpawnEntity_Request": (
        "string name\nbool allow_renaming\nstring uri\nstring resource_string\n"
        "string entity_namespace\ngeometry_msgs/PoseStamped initial_pose"
    ),
    "simulation_interfaces/srv/SpawnEntity_Response": f"{RESULT}\nstring entity_name",
    "simulation_interfaces/srv/DeleteEntity_Request": "string entity",
    "simulation_interfaces/srv/DeleteEntity_Response": RESULT,
    "simulation_interfaces/msg/Result": "uint8 result\nstring error_message",
    "simulation_interfaces/msg/SimulationState": "uint8 state",
    "simulation_interfaces/msg/SimulatorFeatures": (
        "uint16[] features\nstring[] spawn_formats\nstring custom_info"
    ),
    "simulation_interfaces/srv/GetSimulatorFeatures_Request": NOTHING,
    "simulation_interfaces/srv/GetSimulatorFeatures_Response": (
        "simulation_interfaces/SimulatorFeatures features"
    ),
    "simulation_interfaces/srv/GetSimulationState_Request": NOTHING,
    "simulation_interfaces/srv/GetSimulationState_Response": (
        "simulation_interfaces/SimulationState state\nsimulation_interfaces/Result result"
    ),
    "simulation_interfaces/srv/SetSimulationState_Request": (
        "simulation_interfaces/SimulationState state"
    ),
    "simulation_interfaces/srv/SetSimulationState_Response": RESULT,
    "simulation_interfaces/srv/StepSimulation_Request": "uint64 steps",
    "simulation_interfaces/srv/StepSimulation_Response": RESULT,
    "simulation_interfaces/srv/ResetSimulation_Request": "uint8 scope",
    "simulation_interfaces/srv/ResetSimulation_Response": RESULT,
    "rmw_dds_common/msg/Gid": "uint8[16] data",
    "rmw_dds_common/msg/NodeEntitiesInfo": (
        "string<=256 node_namespace\nstring<=256 node_name\n"
        "rmw_dds_common/Gid[] reader_gid_seq\nrmw_dds_common/Gid[] writer_gid_seq"
    ),
    "rmw_dds_common/msg/ParticipantEntitiesInfo": (
        "rmw_dds_common/Gid gid\nrmw_dds_common/NodeEntitiesInfo[] node_entities_info_seq"
    ),
}
"""Definition of each type by name. Inner messages are named `package/Name`.

A service has the messages `package/srv/Name_Request` and `_Response`.
"""

INTEGERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
TYPE_IDS = {base: number for number, base in enumerate((*INTEGERS, "float32", "float64"), 2)}
TYPE_IDS |= {"bool": 15, "byte": 16, "string": 17}
"""Numbers of the primitives in descriptions of types (REP-2011)."""
NESTED, BOUNDED_STRING, ARRAY, SEQUENCE = 1, 21, 48, 144
"""Numbers of other types (REP-2011). For an array, ARRAY is added to the number of the values'
type; for a sequence, SEQUENCE is added.
"""


@dataclass(frozen=True)
class Field:
    """A member of a message."""

    name: str
    base: str
    """Name of a primitive such as `uint8` or `string`, or full name of a message."""
    length: int | None
    """None for a single value, 0 for a sequence of any length, otherwise the length of an array."""
    bound: int | None = None
    """Largest length of the string [bytes]; None if there is no limit."""


_LINE = re.compile(
    r"(?P<base>[\w/]+)(<=(?P<bound>\d+))?(?P<array>\[(?P<count>\d*)\])? (?P<name>\w+)$"
)


@cache
def fields(name: str) -> tuple[Field, ...]:
    """Return the members of `package/msg/Name` in wire order; raise KeyError for unknown types."""
    return tuple(_field(line) for line in DEFINITIONS[name].splitlines())


def definition(name: str) -> str:
    """Return the `ros2msg` text of a message and all its inner messages, as in MCAP schemas."""
    blocks = [DEFINITIONS[name]]
    blocks += [f"MSG: {i.replace('/msg/', '/')}\n{DEFINITIONS[i]}" for i in _inner(name)]
    return f"\n{SEPARATOR}\n".join(blocks) + "\n"


@cache
def type_hash(name: str) -> str:
    """Return the RIHS01 hash of a type (REP-2011): SHA-256 of the type's description as JSON."""
    description = {
        "type_description": _description(name),
        "referenced_type_descriptions": [_description(inner) for inner in sorted(_inner(name))],
    }
    return f"RIHS01_{hashlib.sha256(json.dumps(description).encode()).hexdigest()}"


def _description(name: str) -> dict[str, Any]:
    return {"type_name": name, "fields": [_field_description(member) for member in fields(name)]}


def _field_description(member: Field) -> dict[str, Any]:
    number = BOUNDED_STRING if member.bound else TYPE_IDS.get(member.base, NESTED)
    if member.length is not None:
        number += ARRAY if member.length else SEQUENCE
    kind = {
        "type_id": number,
        "capacity": member.length or 0,
        "string_capacity": member.bound or 0,
        "nested_type_name": member.base if member.base in DEFINITIONS else "",
    }
    return {"name": member.name, "type": kind}


def _field(line: str) -> Field:
    match = _LINE.match(line)
    if match is None:
        raise ValueError(f"not a message member: {line!r}")
    base = match["base"].replace("/", "/msg/")
    length = int(match["count"] or 0) if match["array"] else None
    bound = int(match["bound"]) if match["bound"] else None
    return Field(match["name"], base, length, bound)


def _inner(name: str) -> list[str]:
    types: list[str] = []
    for member in fields(name):
        if member.base in DEFINITIONS:
            types += [member.base, *_inner(member.base)]
    return list(dict.fromkeys(types))
