# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A simulated robot, its localizer and RViz: `ros2 launch fnn_ekf_ros demo.launch.py`."""

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

GEOMETRY = {
    "wheel_radius": 0.025,
    "wheel_separation": 0.6,
    "encoder_counts_per_revolution": 500.0,
}
"""The paper's robot, for both nodes."""


def is_installed(package: str) -> bool:
    """Return whether a ROS package can be found."""
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True


def generate_launch_description() -> LaunchDescription:
    """Describe the three of them; RViz only where it is installed."""
    arguments = [
        DeclareLaunchArgument(
            "rviz", default_value="true", description="Open RViz if it is installed."
        ),
        DeclareLaunchArgument(
            "path",
            default_value="square",
            description="What the robot drives: square, round, figure_eight, sim1, sim2, or "
            "cmd_vel to follow that topic.",
        ),
        DeclareLaunchArgument(
            "faults_file",
            default_value="none",
            description="Timeline of faults, such as share/fnn_ekf_ros/config/faults_example.yaml.",
        ),
    ]
    given = {
        name: ParameterValue(LaunchConfiguration(name), value_type=str)
        for name in ("path", "faults_file")
    }
    fake_robot = Node(
        package="fnn_ekf_ros",
        executable="fake_robot",
        parameters=[GEOMETRY, given],
        output="screen",
        on_exit=Shutdown(reason="fake_robot has ended"),
    )
    localizer = Node(
        package="fnn_ekf_ros",
        executable="localizer",
        parameters=[GEOMETRY, {"publish_tf": True}],
        output="screen",
        on_exit=Shutdown(reason="localizer has ended"),
    )
    if is_installed("rviz2"):
        config = PathJoinSubstitution([FindPackageShare("fnn_ekf_ros"), "config", "localizer.rviz"])
        rviz = Node(
            package="rviz2",
            executable="rviz2",
            arguments=["-d", config],
            condition=IfCondition(LaunchConfiguration("rviz")),
        )
    else:
        rviz = LogInfo(
            msg="rviz2 is not installed: no picture, but all topics",
            condition=IfCondition(LaunchConfiguration("rviz")),
        )
    return LaunchDescription([*arguments, fake_robot, localizer, rviz])
