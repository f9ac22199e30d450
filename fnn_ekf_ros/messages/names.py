# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Names and types of the topics, and what the numbers of `~/noise` are."""

import re

from fnn_ekf_ros.core.arrays import Row
from fnn_ekf_ros.core.evidence import SCALES
from fnn_ekf_ros.core.joint_state import HYPOTHESES
from fnn_ekf_ros.core.lasting.members import MEMBERS
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters

LEFT_TICKS = "left_ticks"
RIGHT_TICKS = "right_ticks"
JOINT_STATES = "joint_states"
COMPASS = "compass"
LRF_POSE = "lrf_pose"
INITIAL_POSE = "initialpose"
ODOM = "odom"
NOISE = "noise"
DIAGNOSTICS = "/diagnostics"
GROUND_TRUTH = "ground_truth"
CMD_VEL = "cmd_vel"
CLOCK = "/clock"
TF = "/tf"
"""Names of the topics."""

ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
DIAGNOSTICS_TYPE = "diagnostic_msgs/msg/DiagnosticArray"
NOISE_TYPE = "std_msgs/msg/Float64MultiArray"
NUMBER_TYPE = "std_msgs/msg/Float64"
TICKS_TYPE = "std_msgs/msg/Int32"
JOINT_STATES_TYPE = "sensor_msgs/msg/JointState"
COMPASS_TYPE = "sensor_msgs/msg/Imu"
POSE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
TWIST_TYPE = "geometry_msgs/msg/Twist"
TF_TYPE = "tf2_msgs/msg/TFMessage"
"""Names of the message types."""

_NAME = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
"""Form of a topic's name."""
_LONGEST_NAME = 247
"""RMW_TOPIC_MAX_NAME_LENGTH [characters]."""

INPUT_TYPES = {
    LEFT_TICKS: TICKS_TYPE,
    RIGHT_TICKS: TICKS_TYPE,
    JOINT_STATES: JOINT_STATES_TYPE,
    COMPASS: COMPASS_TYPE,
    LRF_POSE: POSE_TYPE,
    INITIAL_POSE: POSE_TYPE,
}
"""Topics the localizer can listen to."""

NOISE_FIELDS = (
    "measurement_noise_x",
    "measurement_noise_y",
    "measurement_noise_compass_yaw",
    "measurement_noise_lrf_yaw",
    "process_noise_forward",
    "process_noise_heading",
    "nis",
    "degrees_of_freedom",
    *(f"innovation_{row.name.lower()}" for row in Row),
    *(f"innovation_variance_{row.name.lower()}" for row in Row),
    *(f"mismatch_{row.name.lower()}" for row in Row),
    *(
        f"firing_{rule}_{row.name.lower()}"
        for row in Row
        for rule in ("increase", "maintain", "decrease")
    ),
    *(f"log_scale_{name}" for name in SCALES),
    *(f"weight_{name}" for name in HYPOTHESES),
    "nis_compass",
    "nis_lrf_pose",
    "rejected_compass",
    "rejected_lrf_pose",
    "relocated",
    *(
        f"firing_{rule}_{axis}"
        for axis in ("distance", "rotation")
        for rule in ("increase", "maintain", "decrease")
    ),
    *(
        f"weight_fix_{member.fix_factor:g}{'_yaw' if member.yaw_std > 0.0 else ''}"
        for member in MEMBERS
    ),
    "lasting_fix_std",
    "lasting_time_constant",
    "lasting_yaw_std",
    "compass_offset",
    "compass_offset_std",
    "compass_offset_believed",
    "compass_doubted",
)
"""Names of the numbers of `~/noise`, in order; variances in m^2 and rad^2.

NIS and degrees of freedom are summed over the readings of the period; what is given by row is
that of its last reading.

The firing strengths by row are R's; in mode `joint` those of the four log scales, in their order;
in mode `q`, which has none of R, Q's in the rows of x and compass yaw. Log scales and weights are
0 in the other modes than `joint`. What is true or false is 1 or 0.

The weights by fix factor, with or without lasting yaw errors, and what follows them are of lasting
errors (m, s, rad); 0 where these are not followed.
"""

STD_TOPICS = {
    "measurement_noise_x": "noise/lrf_x_std",
    "measurement_noise_y": "noise/lrf_y_std",
    "measurement_noise_lrf_yaw": "noise/lrf_yaw_std",
    "measurement_noise_compass_yaw": "noise/compass_std",
    "process_noise_forward": "noise/distance_std",
    "process_noise_heading": "noise/rotation_std",
}
"""Private topic of the square root of a variance in `~/noise` (m, rad), by its field."""
NIS_TOPICS = ("nis/compass", "nis/lrf_pose")
"""Private topics of each sensor's NIS per degree of freedom, in the order of the gate."""
LASTING_TOPICS = {
    "lasting_fix_std": "lasting/fix_std",
    "lasting_yaw_std": "lasting/yaw_std",
    "compass_offset": "lasting/compass_offset",
    "compass_offset_std": "lasting/compass_offset_std",
}
"""Private topic of a number in `~/noise` about lasting errors (m, rad), by its field."""
NUMBER_TOPICS = (*STD_TOPICS.values(), *NIS_TOPICS, *LASTING_TOPICS.values())
"""Private topics of one number each, published beside `~/noise` to be plotted by name."""


def output_topics() -> dict[str, str]:
    """Return the type of each topic that the localizer publishes with an estimate.

    The names are those of a node before it is remapped: a private one begins with `~/`.
    """
    private = {NOISE: NOISE_TYPE, **dict.fromkeys(NUMBER_TOPICS, NUMBER_TYPE)}
    return {ODOM: ODOMETRY_TYPE, **{f"~/{name}": kind for name, kind in private.items()}}


def input_topics(parameters: LocalizerParameters) -> tuple[str, ...]:
    """Return the topics that a localizer with these parameters listens to."""
    wheels = (JOINT_STATES,) if parameters.encoder_source == "joint_states" else (
        LEFT_TICKS, RIGHT_TICKS,
    )  # fmt: skip
    return (COMPASS, LRF_POSE, INITIAL_POSE, *wheels)


def is_topic_name(text: str) -> bool:
    """Return whether ROS allows a text as a topic's name, absolute or relative."""
    return bool(_NAME.fullmatch(text)) and len(absolute_name(text)) <= _LONGEST_NAME


def absolute_name(topic: str) -> str:
    """Return a topic's name as it is recorded, without a namespace."""
    if topic.startswith("~/"):
        return f"/{NODE_NAME}/{topic[2:]}"
    return topic if topic.startswith("/") else f"/{topic}"
