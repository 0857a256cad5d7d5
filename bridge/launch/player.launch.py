"""Start the player, or a running simulation, and RViz.

The command is `ros2 launch phy124_bridge player.launch.py clip:=/path/clip.safetensors`. To
simulate a picture instead, pass `source:=/path/photo.png scene:=drop`. Type checkers do not find
the module launch, which comes with ROS 2 and is in no package index.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, LogInfo, OpaqueFunction
from launch.conditions import IfCondition
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "phy124_bridge"
PARAMETERS = {
    "clip": (str, "A clip.safetensors made by phy124; give either clip or source."),
    "source": (str, "A picture or a file of Gaussians, simulated while it is shown."),
    "scene": (str, "With source: preset (see `phy124 scenes`) or path of a .toml file."),
    "profile": (str, "Values per point: viz, full, small, ply or splats."),
    "frame_id": (str, "Coordinate frame of the object's world."),
    "speed": (float, "Playback speed: seconds of the clip per real second."),
    "rate": (float, "Largest number of frames per second; 0 means every frame."),
    "loop": (bool, "Start again after the last frame."),
}
"""Type and description of each argument; an empty value keeps the value in the parameter file."""
PLAYER = ("clip", "profile", "frame_id", "speed", "rate", "loop")
SIMULATED = ("source", "scene", "profile", "frame_id", "speed")


def generate_launch_description():
    """Return the launch description; users must set either `clip` or `source`."""
    config = PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "player.yaml"])
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value="", description=description)
                for name, (_, description) in PARAMETERS.items()
            ),
            DeclareLaunchArgument("config", default_value=config, description="Parameter file."),
            DeclareLaunchArgument(
                "namespace",
                default_value="phy124",
                description="Namespace of the node and its topics; RViz uses the same namespace.",
            ),
            DeclareLaunchArgument(
                "managed",
                default_value="false",
                description="With clip: start a lifecycle node, which a manager activates.",
            ),
            DeclareLaunchArgument(
                "rviz", default_value="true", description="Also open RViz if it is installed."
            ),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context):
    values = {name: LaunchConfiguration(name).perform(context) for name in PARAMETERS}
    if bool(values["clip"]) == bool(values["source"]):
        # launch reports a nonzero exit status only if an exception is raised.
        raise ValueError("Give clip:=/path/clip.safetensors, or source:=/path/photo.png.")
    namespace = "/" + LaunchConfiguration("namespace").perform(context).strip("/")
    executable, names = ("simulate", SIMULATED) if values["source"] else ("player", PLAYER)
    if IfCondition(LaunchConfiguration("managed")).evaluate(context):
        if values["source"]:
            raise ValueError("managed:=true needs clip:=/path/clip.safetensors.")
        executable = "managed"
    parameters = {
        name: ParameterValue(LaunchConfiguration(name), value_type=PARAMETERS[name][0])
        for name in names
        if values[name]
    }
    node = Node(
        package=PACKAGE,
        executable=executable,
        name="player",
        namespace=namespace,
        parameters=[LaunchConfiguration("config"), parameters],
        output="screen",
        on_exit=_end,
    )
    return [node, *_rviz(namespace)]


def _end(event, context):
    """End RViz when the node has ended; raise an error if the node's exit status is not zero."""
    del context
    if event.returncode:
        raise RuntimeError(f"The {PACKAGE} node has ended with exit status {event.returncode}.")
    return EmitEvent(event=Shutdown(reason="the player has ended"))


def _rviz(namespace):
    try:
        get_package_prefix("rviz2")
    except PackageNotFoundError:
        return [LogInfo(msg="rviz2 is not installed: the player runs without it.")]
    view = PathJoinSubstitution([FindPackageShare(PACKAGE), "rviz", "phy124.rviz"])
    return [
        Node(
            package="rviz2",
            executable="rviz2",
            arguments=["-d", view],
            remappings=[
                (f"/phy124/{topic}", f"{namespace}/{topic}") for topic in ("points", "ellipsoids")
            ],
            condition=IfCondition(LaunchConfiguration("rviz")),
        )
    ]
