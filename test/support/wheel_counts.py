# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Counts of a robot that drives straight ahead, and what is reported of its encoders."""

import math
from typing import Any

import numpy as np
from localizers import PERIOD_NS, Arrival, status_at_end, statuses

from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.timeline.events import Output, Status, Wheel, WheelCount

STEP_NS = 25_000_000
BEGIN_NS = 8 * PERIOD_NS
METERS_PER_COUNT = math.pi * 0.05 / 500.0
AT_ORIGIN = {"initial_pose": [0.0, 0.0, 0.0], "adaptation": "none"}
SOURCES = ["ticks", "joint_states"]


def encoders(localizer: Localizer) -> Status:
    """Return the current status of the encoders."""
    return status_at_end(localizer, "encoders")


def encoder_reports(outputs: list[Output]) -> list[Status]:
    """Return all statuses of the encoders."""
    return statuses(outputs, "encoders")


def last_mean(outputs: list[Output]) -> np.ndarray:
    estimate = outputs[-1].estimate
    assert estimate is not None
    return estimate.state.mean


def straight(source: str, steps: int, per_step: int = 20, start: int = 0) -> list[Any]:
    """Return arrivals of a robot that drives straight ahead, so many counts in each 25 ms."""
    scale = 1 if source == "ticks" else METERS_PER_COUNT / 0.025
    return [
        Arrival(stamp, WheelCount(stamp, wheel, (start + per_step * number) * scale))
        for number in range(steps)
        for stamp in [BEGIN_NS + number * STEP_NS]
        for wheel in Wheel
    ]
