"""The player and RViz: `ros2 launch phy124_bridge player.launch.py clip:=/path/clip.safetensors`.

launch comes with ROS 2 and is on no package index, so type checkers do not find it.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

PACKAGE = "phy124_bridge"


def generate_launch_description() -> LaunchDescription:
    """Arguments: clip (needed), config, rviz (true or false)."""
    share = FindPackageShare(PACKAGE)
    config = PathJoinSubstitution([share, "config", "player.yaml"])
    view = PathJoinSubstitution([share, "rviz", "phy124.rviz"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("clip", description="A clip.safetensors made by phy124."),
            DeclareLaunchArgument("config", default_value=config, description="Parameter file."),
            DeclareLaunchArgument("rviz", default_value="true", description="Open RViz, too."),
            Node(
                package=PACKAGE,
                executable="player",
                name="player",
                namespace="phy124",
                parameters=[LaunchConfiguration("config"), {"clip": LaunchConfiguration("clip")}],
                output="screen",
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", view],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
        ]
    )
