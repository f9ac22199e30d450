# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `localizer` and `replay`."""

import math
from dataclasses import dataclass

from fnn_ekf_ros.core.adaptation import AdaptationMode, InferenceKind
from fnn_ekf_ros.core.limits import LARGEST_POSITION, LARGEST_STD, SMALLEST_STD
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.parameters.paper import MEASUREMENT_STD, SIMULATION_2_STD, YAW_STD
from fnn_ekf_ros.parameters.schema import NO_FILE, ParameterError, Parameters, parameter, refusal

NODE_NAME = "localizer"
"""The node's name, which parameter files have as their section."""
MOST_PERIODS_KEPT = 500
"""Largest number of states kept to go back to for late inputs: running so many periods again takes
half a second."""
GATE = 1e-6
"""Default of the gates: the probability with which a correct reading is rejected, one in a million,
about five standard deviations."""
LARGEST_DELAY_S = 2.0
"""Largest correction of a sensor's stamps, either way [s]: readings older than the default history
are dropped."""
NO_FRAME = "none"
"""Value of a frame parameter for no frame."""
SAME_FILE = "same"
"""Value of a file parameter for another parameter's file."""
NOT_SET = (math.nan, math.nan, math.nan)
"""Value of `initial_pose` for no pose (m, m, rad)."""


@dataclass(frozen=True, slots=True)
class LocalizerParameters(Parameters):
    """Parameters of the localizer; the start is the paper's simulation 2 and its eq. (25)."""

    # Geometry: no usable default.
    wheel_radius: float = parameter(
        0.0,
        "Radius of the wheels, D / 2; set it to your robot's.",
        "m",
        at_least=1e-4,
        at_most=10.0,
        required=True,
    )
    wheel_separation: float = parameter(
        0.0,
        "Distance between the wheels' contact points, L; set it to your robot's.",
        "m",
        at_least=1e-3,
        at_most=100.0,
        required=True,
    )
    gear_ratio: float = parameter(
        1.0, "Encoder turns per wheel turn, n.", "", at_least=1e-6, at_most=1e6
    )
    encoder_counts_per_revolution: float = parameter(
        0.0,
        "Counts per turn of the encoder, C_e; needed unless encoder_source is joint_states.",
        "counts",
        at_least=0.0,
        at_most=1e9,
    )

    # Encoders
    encoder_source: str = parameter(
        "ticks",
        "Where wheel motion comes from: ticks (left_ticks, right_ticks) or joint_states.",
        choices=("ticks", "joint_states"),
    )
    encoder_bits: int = parameter(
        32,
        "Width of the counters; they wrap at 2^bits, signed or unsigned.",
        "bits",
        at_least=8,
        at_most=32,
    )
    left_inverted: bool = parameter(False, "Left counts fall when the robot drives forward.")
    right_inverted: bool = parameter(False, "Right counts fall when the robot drives forward.")
    left_wheel_radius_multiplier: float = parameter(
        1.0,
        "Radius of the left wheel over wheel_radius.",
        "",
        at_least=0.1,
        at_most=10.0,
    )
    right_wheel_radius_multiplier: float = parameter(
        1.0,
        "Radius of the right wheel over wheel_radius.",
        "",
        at_least=0.1,
        at_most=10.0,
    )
    left_joint: str = parameter("left_wheel_joint", "Name of the left wheel in joint_states.")
    right_joint: str = parameter("right_wheel_joint", "Name of the right wheel in joint_states.")
    max_wheel_speed: float = parameter(
        5.0,
        "Fastest a wheel's rim ever moves; counts that jump further are a reset or a glitch, and "
        "no motion.",
        "m/s",
        at_least=1e-3,
        at_most=1e3,
    )

    # Time
    period: float = parameter(
        NOMINAL_PERIOD_S,
        "Time between two odom messages, which are stamped with its multiples; every reading is "
        "fused at its own time, whatever the period.",
        "s",
        at_least=0.01,
        at_most=10.0,
    )
    encoder_timeout: float = parameter(
        0.5,
        "How long a period waits for both wheels before it is closed without them.",
        "s",
        at_least=0.0,
        at_most=60.0,
    )
    history: float = parameter(
        2.0,
        "How late a measurement may come and still be fused at the time it was taken.",
        "s",
        at_least=0.0,
        at_most=10.0,
    )
    output_delay: float = parameter(
        0.0,
        "How long a finished period waits for late measurements before its odom is published.",
        "s",
        at_least=0.0,
        at_most=10.0,
    )

    # Filter
    motion_model: str = parameter(
        "exact_arc",
        "Motion from one reading to the next: exact_arc, or paper (eq. 4) to reproduce the paper.",
        choices=tuple(MotionModel),
    )
    process_noise_std: tuple[float, float] = parameter(
        SIMULATION_2_STD,
        "Wheel noise of 375 ms, whatever the period: distance, rotation (sqrt of Q).",
        "[m, rad]",
        at_least=SMALLEST_STD,
        at_most=LARGEST_STD,
    )
    measurement_noise_std: tuple[float, float, float] = parameter(
        MEASUREMENT_STD,
        "Noise of the laser fixes' x, y and of the compass (sqrt of R).",
        "[m, m, rad]",
        at_least=SMALLEST_STD,
        at_most=LARGEST_STD,
    )
    lrf_use_yaw: bool = parameter(False, "Use the laser fixes' yaw, beside the compass.")
    lrf_yaw_std: float = parameter(
        YAW_STD, "Noise of the laser fixes' yaw.", "rad", at_least=SMALLEST_STD, at_most=LARGEST_STD
    )
    lrf_use_message_covariance: bool = parameter(
        False, "Take R of the laser fixes from their messages, times the adapted scale."
    )
    lrf_yaw_offset: float = parameter(
        0.0,
        "Added to the laser fixes' yaw, counter-clockwise.",
        "rad",
        at_least=-2.0 * math.pi,
        at_most=2.0 * math.pi,
    )
    lrf_pose_scale: float = parameter(
        1.0,
        "Meters per unit of the laser fixes' x and y: 0.001 for fixes in millimeters.",
        "m",
        at_least=1e-6,
        at_most=1e6,
    )
    compass_clockwise: bool = parameter(
        False,
        "The compass yaw grows clockwise, as in NED; with compass_offset pi / 2 for zero at north.",
    )
    compass_offset: float = parameter(
        0.0,
        "Added to the compass yaw, counter-clockwise (minus an east-positive declination).",
        "rad",
        at_least=-2.0 * math.pi,
        at_most=2.0 * math.pi,
    )
    compass_delay: float = parameter(
        0.0,
        "How much later than the measurement the compass is stamped; subtracted from its stamps.",
        "s",
        at_least=-LARGEST_DELAY_S,
        at_most=LARGEST_DELAY_S,
    )
    lrf_pose_delay: float = parameter(
        0.0,
        "How much later than the measurement the laser fixes are stamped; subtracted from their "
        "stamps.",
        "s",
        at_least=-LARGEST_DELAY_S,
        at_most=LARGEST_DELAY_S,
    )

    # Outliers
    compass_gate: float = parameter(
        GATE,
        "Chance that a correct compass reading is taken for an outlier; 0: none ever is.",
        "",
        at_least=0.0,
        at_most=0.5,
    )
    lrf_pose_gate: float = parameter(
        GATE,
        "Chance that a correct fix is taken for an outlier; 0: none ever is.",
        "",
        at_least=0.0,
        at_most=0.5,
    )

    # Adaptation
    adaptation: str = parameter(
        "joint",
        "What the fuzzy neural network adapts: joint (Q and R, by evidence), rq (Q and R, as in "
        "the paper), r (R alone), q (Q alone) or none.",
        choices=tuple(AdaptationMode),
        at_run_time=True,
    )
    lasting_errors: bool = parameter(
        True,
        "Follow errors of fixes and compass that last for seconds to minutes, and a compass that "
        "is off by a constant; adaptation: joint only.",
    )
    innovation_window: int = parameter(
        45,
        "Number of innovations, one a period, that modes r, q and rq compare with the filter's "
        "expectation, N.",
        "",
        at_least=2,
        at_most=1000,
    )
    membership_file: str = parameter(
        "published",
        "Membership functions for R, modes r and rq: initial or published (the paper's), "
        "trained, or a file's path.",
    )
    process_membership_file: str = parameter(
        SAME_FILE,
        "Membership functions for Q, modes q and rq: as above; same: those of membership_file.",
    )
    joint_membership_file: str = parameter(
        "joint", "Membership functions of mode joint: joint, or a file's path."
    )
    inference: str = parameter(
        "tsukamoto",
        "tsukamoto (the network), or centroid (the plain fuzzy system, eq. 18).",
        choices=tuple(InferenceKind),
    )
    process_noise_std_min: tuple[float, float] = parameter(
        (1e-4, 1e-4),
        "Smallest process noise the adaptation may set.",
        "[m, rad]",
        at_least=SMALLEST_STD,
        at_most=LARGEST_STD,
        at_run_time=True,
    )
    process_noise_std_max: tuple[float, float] = parameter(
        (10.0, 3.0),
        "Largest process noise the adaptation may set.",
        "[m, rad]",
        at_least=SMALLEST_STD,
        at_most=LARGEST_STD,
        at_run_time=True,
    )
    measurement_noise_std_min: tuple[float, float, float] = parameter(
        (1e-3, 1e-3, 1e-3),
        "Smallest measurement noise the adaptation may set (yaw for both).",
        "[m, m, rad]",
        at_least=SMALLEST_STD,
        at_most=LARGEST_STD,
        at_run_time=True,
    )
    measurement_noise_std_max: tuple[float, float, float] = parameter(
        (1e3, 1e3, 3.0),
        "Largest measurement noise the adaptation may set (yaw for both).",
        "[m, m, rad]",
        at_least=SMALLEST_STD,
        at_most=LARGEST_STD,
        at_run_time=True,
    )

    # Start
    initial_pose: tuple[float, float, float] = parameter(
        NOT_SET,
        "Pose to start from; .nan: wait until x, y and yaw have been measured.",
        "[m, m, rad]",
        at_least=-LARGEST_POSITION,
        at_most=LARGEST_POSITION,
        may_be_nan=True,
    )
    initial_pose_std: tuple[float, float, float] = parameter(
        MEASUREMENT_STD,
        "How well initial_pose is known.",
        "[m, m, rad]",
        at_least=SMALLEST_STD,
        at_most=LARGEST_STD,
    )

    # Frames
    frame_id: str = parameter("map", "Frame of odom and of the fixes.")
    base_frame: str = parameter("base_link", "Frame of the robot: the middle of the axle.")
    publish_tf: bool = parameter(
        False, "Publish the pose as a transform, too: frame_id to base_frame, or to odom_frame."
    )
    odom_frame: str = parameter(
        NO_FRAME,
        "Frame in which someone else publishes base_frame: then frame_id to odom_frame is "
        "published instead (Nav2's map to odom); none: there is none.",
    )
    transform_tolerance: float = parameter(
        0.5,
        "How far ahead the transform to odom_frame is stamped: it holds until the next one.",
        "s",
        at_least=0.0,
        at_most=10.0,
    )

    # Saved state
    state_file: str = parameter(
        NO_FILE,
        "File in which the node keeps the adapted noise and the pose, once a minute and at the "
        "end; none: nowhere.",
    )
    warm_start: bool = parameter(
        False, "Start with the noise and the pose in state_file, if they can be read."
    )

    def check(self) -> None:
        """Check that ticks have a size and that the noise starts within its bounds.

        Raises:
            ParameterError: no counts per revolution, or a start outside of its bounds.
        """
        if self.history > MOST_PERIODS_KEPT * self.period:
            raise refusal(
                "history", self.history,
                f"at most {MOST_PERIODS_KEPT} periods of {self.period:g} s",
            )  # fmt: skip
        if self.encoder_source == "ticks" and self.encoder_counts_per_revolution < 1e-3:
            raise ParameterError(
                "parameter 'encoder_counts_per_revolution' is not set: expected a number greater "
                "than 0 [counts]; set it to the counts per turn of the encoder"
            )
        frames = [self.frame_id, self.base_frame]
        if self.odom_frame != NO_FRAME:
            frames.append(self.odom_frame)
        if self.publish_tf and len(set(frames)) < len(frames):
            raise refusal(
                "publish_tf", True, f"frames of different names, not {', '.join(frames)}"
            )  # fmt: skip
        if self.warm_start and self.state_file == NO_FILE:
            raise refusal("warm_start", True, "a state_file to start from")
        self._check_bounds("process_noise_std", self.process_noise_std)
        self._check_bounds("measurement_noise_std", self.measurement_noise_std)
        low, high = self.measurement_noise_std_min[2], self.measurement_noise_std_max[2]
        if not low <= self.lrf_yaw_std <= high:
            raise refusal(
                "lrf_yaw_std", self.lrf_yaw_std,
                f"a number from {low:g} to {high:g}, the yaw entries of "
                "measurement_noise_std_min and _max",
            )  # fmt: skip

    def _check_bounds(self, name: str, start: tuple[float, ...]) -> None:
        low: tuple[float, ...] = getattr(self, f"{name}_min")
        high: tuple[float, ...] = getattr(self, f"{name}_max")
        if not all(a <= x <= b for a, x, b in zip(low, start, high, strict=True)):
            raise refusal(
                name, start, f"numbers between {name}_min {list(low)} and {name}_max {list(high)}"
            )
