# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Times, geometry and types that tests of the localizer share."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.timeline.events import Event, Output, Status

PERIOD_NS = 375_000_000
"""The paper's period [ns]."""
SECOND_NS = 10**9
"""A second [ns]."""
START_NS = 3 * SECOND_NS
"""ROS time at which simulated runs begin [ns]: ROS time 0 means no time."""
GEOMETRY = {
    "wheel_radius": 0.025,
    "wheel_separation": 0.6,
    "encoder_counts_per_revolution": 500.0,
}
"""The paper's robot, as parameters."""
JOINTS = {"encoder_source": "joint_states"}
"""Parameters with joint states in place of ticks."""


class Arrival(NamedTuple):
    """An event and the ROS time at which it came in [ns]."""

    now_ns: int
    event: Event


class Run(NamedTuple):
    """What a simulated robot sent: events as they arrive, and the true pose by stamp."""

    arrivals: tuple[Arrival, ...]
    truth: dict[int, FloatArray]


MakePipeline = Callable[..., Localizer]
Feed = Callable[[Localizer, Iterable[Any]], list[Output]]
Same = Callable[[list[Output], list[Output]], None]


def estimates(outputs: list[Output]) -> list[Output]:
    """Return the outputs with an estimate: those from the filter's start on."""
    return [output for output in outputs if output.estimate is not None]


def status_at_end(pipeline: Localizer, name: str) -> Status:
    """Return the current status of a name."""
    return next(status for status in pipeline.report() if status.name == name)


def time_values(pipeline: Localizer) -> dict[str, str]:
    """Return the values of the status `time` by key."""
    return dict(status_at_end(pipeline, "time").values)


def statuses(outputs: list[Output], name: str) -> list[Status]:
    """Return all statuses of a name in outputs."""
    return [s for output in outputs for s in output.statuses or () if s.name == name]
