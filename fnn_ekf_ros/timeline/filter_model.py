# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""From the localizer's parameters to the core's models."""

import math

from fnn_ekf_ros.core.adaptation import (
    Adaptation,
    AdaptationMode,
    InferenceKind,
    Networks,
)
from fnn_ekf_ros.core.bounds import NoiseBounds
from fnn_ekf_ros.core.gate import gate_for
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.odometry import WheelGeometry
from fnn_ekf_ros.core.state import FilterModel
from fnn_ekf_ros.parameters.localizer import LocalizerParameters


def wheel_geometry(parameters: LocalizerParameters) -> WheelGeometry:
    """Return the geometry; with joint_states a "count" is one radian of the wheel."""
    if parameters.encoder_source == "joint_states":
        return WheelGeometry(
            wheel_radius=parameters.wheel_radius,
            wheel_separation=parameters.wheel_separation,
            gear_ratio=1.0,
            encoder_counts_per_revolution=2.0 * math.pi,
            left_multiplier=parameters.left_wheel_radius_multiplier,
            right_multiplier=parameters.right_wheel_radius_multiplier,
        )
    return WheelGeometry(
        wheel_radius=parameters.wheel_radius,
        wheel_separation=parameters.wheel_separation,
        gear_ratio=parameters.gear_ratio,
        encoder_counts_per_revolution=parameters.encoder_counts_per_revolution,
        left_multiplier=parameters.left_wheel_radius_multiplier,
        right_multiplier=parameters.right_wheel_radius_multiplier,
    )


def filter_model(parameters: LocalizerParameters, networks: Networks) -> FilterModel:
    """Return the filter's model."""
    p = parameters
    return FilterModel(
        motion_model=MotionModel(p.motion_model),
        period_s=p.period,
        process_noise=_process(p.process_noise_std),
        measurement_noise=measurement_noise(p),
        adaptation=Adaptation(
            mode=AdaptationMode(p.adaptation),
            kind=InferenceKind(p.inference),
            networks=networks,
            window_length=p.innovation_window,
            bounds=noise_bounds(p),
        ),
        gate=gate_for(p.compass_gate, p.lrf_pose_gate),
        lasting_errors=p.lasting_errors,
    )


def noise_bounds(parameters: LocalizerParameters) -> NoiseBounds:
    """Return what no adaptation can leave."""
    p = parameters
    low, high = p.measurement_noise_std_min, p.measurement_noise_std_max
    return NoiseBounds(
        process_min=_process(p.process_noise_std_min),
        process_max=_process(p.process_noise_std_max),
        measurement_min=_measurement(low, low[2]),
        measurement_max=_measurement(high, high[2]),
    )


def measurement_noise(parameters: LocalizerParameters) -> tuple[float, float, float, float]:
    """Return the diagonal of R to start with, rows as in `Row`."""
    return _measurement(parameters.measurement_noise_std, parameters.lrf_yaw_std)


def _process(std: tuple[float, float]) -> tuple[float, float]:
    return std[0] ** 2, std[1] ** 2


def _measurement(
    std: tuple[float, float, float], lrf_yaw_std: float
) -> tuple[float, float, float, float]:
    return std[0] ** 2, std[1] ** 2, std[2] ** 2, lrf_yaw_std**2
