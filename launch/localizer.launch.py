# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The localizer of one robot: `ros2 launch fnn_ekf_ros localizer.launch.py params_file:=FILE`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

TOPICS = {
    "lrf_pose": "fixes, such as /amcl_pose",
    "compass": "yaw with a fixed zero, such as /imu/data",
    "joint_states": "wheels, with encoder_source: joint_states",
    "left_ticks": "left encoder, with encoder_source: ticks",
    "right_ticks": "right encoder, with encoder_source: ticks",
    "initialpose": "pose that is set by hand",
    "odom": "the localizer's pose",
}
"""Topics that can be remapped: each is an argument with its own name as default."""


def generate_launch_description() -> LaunchDescription:
    """Describe the localizer and its arguments."""
    arguments = [
        DeclareLaunchArgument(
            "params_file",
            description="Parameter file of your robot: wheel_radius, wheel_separation and, for "
            "ticks, encoder_counts_per_revolution have no default that fits. "
            "share/fnn_ekf_ros/config/localizer.yaml lists all parameters.",
        ),
        DeclareLaunchArgument("namespace", default_value="", description="Of node and topics."),
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="false",
            choices=["true", "false", "True", "False"],
            description="Take the time from /clock; this wins over the parameter file.",
        ),
        DeclareLaunchArgument(
            "log_level",
            default_value="info",
            choices=["debug", "info", "warn", "error", "fatal"],
            description="Least severe lines of the log that are shown.",
        ),
        *(
            DeclareLaunchArgument(topic, default_value=topic, description=f"Topic: {meaning}.")
            for topic, meaning in TOPICS.items()
        ),
    ]
    localizer = Node(
        package="fnn_ekf_ros",
        executable="localizer",
        namespace=LaunchConfiguration("namespace"),
        remappings=[(topic, LaunchConfiguration(topic)) for topic in TOPICS],
        # Handed on as it is: launch_ros itself passes over a file that does not exist with a
        # warning; the node ends with a line that says which file and why.
        ros_arguments=[
            "--params-file", LaunchConfiguration("params_file"),
            "-p", ["use_sim_time:=", LaunchConfiguration("use_sim_time")],
            "--log-level", LaunchConfiguration("log_level"),
        ],
        output="screen",
    )  # fmt: skip
    return LaunchDescription([*arguments, localizer])
