"""Definitions of the ROS 2 messages that the bridge uses, and their RIHS01 hashes in ROS 2 Jazzy.

Constants are omitted from the definitions, because they are not part of the wire format. The tests
compare the definitions and hashes of ROS 2's own messages with the package rosbags. The messages of
four other packages are defined by names and types only: simulation_interfaces 2.1.0,
splat_interfaces (of RVizSplat), foxglove_msgs and point_cloud_interfaces.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache

SEPARATOR = "=" * 80

NOTHING = "uint8 structure_needs_at_least_one_member"
"""The content of a ROS 2 message without members."""
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

The request and the response of a service are the messages `package/srv/Name_Request` and
`_Response`.
"""

HASHES: dict[str, str] = {
    "std_msgs/msg/Float64": (
        "RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a"
    ),
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
    "sensor_msgs/msg/Image": (
        "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
    ),
    "sensor_msgs/msg/CameraInfo": (
        "RIHS01_b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275"
    ),
    "sensor_msgs/msg/CompressedImage": (
        "RIHS01_15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a"
    ),
    "point_cloud_interfaces/msg/CompressedPointCloud2": (
        "RIHS01_4b38df4932a156a54c53e80a7f34e54e2966b20e54a4d14ded34a165a389c0c1"
    ),
    "foxglove_msgs/msg/CompressedVideo": (
        "RIHS01_32039eafc3770e589c86c4dabff9c392ce9955ebffd43f5f60763011d43d8d1d"
    ),
    "rmw_dds_common/msg/ParticipantEntitiesInfo": (
        "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"
    ),
    "geometry_msgs/msg/WrenchStamped": (
        "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77"
    ),
    "geometry_msgs/msg/PointStamped": (
        "RIHS01_4c0296af86e01e562e9e0405d138a01537247580076c58ea38d7923ac1045897"
    ),
    "splat_interfaces/msg/SplatArray": (
        "RIHS01_68c90e8e9ff1b2237789f7b7712b746a699fe37a3bed11d685f8d6698b4f5abf"
    ),
    "simulation_interfaces/srv/GetEntities_Request": (
        "RIHS01_f0a4c6c0c39c87f84cbd1ea31956b9f39b3fa538ae9c4aa7fc243a32360e8c70"
    ),
    "simulation_interfaces/srv/GetEntities_Response": (
        "RIHS01_dd1916edbdc659d355e77980b16ed6eb4d41d5ff445557931ed65c58b00f7b2c"
    ),
    "simulation_interfaces/srv/GetEntityInfo_Request": (
        "RIHS01_9bdd2628d931108734e304ae1fac80d268a46783fa0060d4a43831c54c30f3b3"
    ),
    "simulation_interfaces/srv/GetEntityInfo_Response": (
        "RIHS01_eaa358f007b09b06645f93b5a1c6ae0389f27bee7747e760122994ab1308e1c8"
    ),
    "simulation_interfaces/srv/GetEntityState_Request": (
        "RIHS01_580141cc957c4ee99a7e46bc545db351ab9ce6c3099d4092b1186ddc6a38bd5a"
    ),
    "simulation_interfaces/srv/GetEntityState_Response": (
        "RIHS01_125f1ca9dc2fc072443deb28587bbb1026fa34db4dfaf59e9a6b7128e0c81331"
    ),
    "simulation_interfaces/srv/SetEntityState_Request": (
        "RIHS01_95cdfbffcd9c4d0133b2079bdcadd4420ce86dd255c11a3dfed7f9f907fd304d"
    ),
    "simulation_interfaces/srv/SetEntityState_Response": (
        "RIHS01_bbd9bcb2def000f1ed8cb9482abff46c5a11cfe4184203f336b920f249d757f4"
    ),
    "simulation_interfaces/srv/SpawnEntity_Request": (
        "RIHS01_fdcf97087f59eed1ad0b75696ea97ffbb44d104f62f177fcd5a31ab67c6fc923"
    ),
    "simulation_interfaces/srv/SpawnEntity_Response": (
        "RIHS01_be8c9fc03b6faaf95570949c80195c8ca75dd99f7efc23262309d497b2923982"
    ),
    "simulation_interfaces/srv/DeleteEntity_Request": (
        "RIHS01_4b41b2ebdc313a0c98c7c2218849edc8b7b905fd759a23b68c576496a47dc792"
    ),
    "simulation_interfaces/srv/DeleteEntity_Response": (
        "RIHS01_2f68929b527a3bbee03637a1c8192f2aa2982807738389aa0781f8e785673ca7"
    ),
    "simulation_interfaces/srv/GetSimulatorFeatures_Request": (
        "RIHS01_982b8c1adef1d556f6ecdc019d1269fc39413626a9222d73b4fc874bd798b7db"
    ),
    "simulation_interfaces/srv/GetSimulatorFeatures_Response": (
        "RIHS01_ede4dc8227cbb2f86a24612c999dcaa67d17dab21dab566cefdc233e7a2a65d1"
    ),
    "simulation_interfaces/srv/GetSimulationState_Request": (
        "RIHS01_c6d65bc5c0a95ca2886bc57f146f803e01722c84ddb5acd5f32a4417f55eecfb"
    ),
    "simulation_interfaces/srv/GetSimulationState_Response": (
        "RIHS01_dc80ce852a5ab04c2b23cdd47910cee1bcc46e0f1931cac85825e6916b15517f"
    ),
    "simulation_interfaces/srv/SetSimulationState_Request": (
        "RIHS01_73283477d36ba619db2ac37a3e599077ca244502c9d8ca2a7183afcb2224f476"
    ),
    "simulation_interfaces/srv/SetSimulationState_Response": (
        "RIHS01_6351aebf2bbf06e2993977918b944240f7403b532a9e4a344c53e71a56afd174"
    ),
    "simulation_interfaces/srv/StepSimulation_Request": (
        "RIHS01_cda33f6887815f3dce0f90e61fd8efd39bda13ae264ddede15c33fbad890630e"
    ),
    "simulation_interfaces/srv/StepSimulation_Response": (
        "RIHS01_5b4acf2d0ce7c3fc125d0bef2acb9b5a81377e80db6b696b81beeffb9824fb5c"
    ),
    "simulation_interfaces/srv/ResetSimulation_Request": (
        "RIHS01_2c766d09c3aa30f01fadc55a42fd760b63db358c7d1d3b6a64ea9978225ffbc7"
    ),
    "simulation_interfaces/srv/ResetSimulation_Response": (
        "RIHS01_718428121e0f1755720878d3c28f1688da7581ee5a5d56d26d10d941a28a50a0"
    ),
}
"""Hash (REP-2011) of the type of each topic, request and response."""


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


def _field(line: str) -> Field:
    match = _LINE.match(line)
    if match is None:
        raise ValueError(f"not a message member: {line!r}")
    base = match["base"].replace("/", "/msg/")
    length = int(match["count"] or 0) if match["array"] else None
    bound = int(match["bound"]) if match["bound"] else None
    return Field(match["name"], base, length, bound)


def _inner(name: str) -> list[str]:
    """List all message types inside `name`, each once, in depth-first order."""
    types: list[str] = []
    for member in fields(name):
        if member.base in DEFINITIONS:
            types += [member.base, *_inner(member.base)]
    return list(dict.fromkeys(types))
