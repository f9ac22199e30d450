# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Cases of `pinned`: the localizer on the packaged bags."""

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from localizers import Arrival
from pinned_studies import UPPER, Records
from places import BAGS

from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.messages.reading import read_input
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.recordings.inputs import TopicNames, inputs_in
from fnn_ekf_ros.timeline.events import (
    CompassYaw,
    Event,
    Output,
    PoseFix,
    PoseReset,
    Rejected,
    Wheel,
    WheelCount,
)

STATUSES = ("encoders", "compass", "lrf_pose", "filter", "time")
Change = Callable[[Event, float], Event | None]
"""Takes an event and its time since the recording's start [s]; None leaves the event out."""


def _unchanged(event: Event, _time: float) -> Event:
    return event


def _carried(event: Event, time: float) -> Event:
    """Carry the robot away at 15 s: the fixes jump."""
    if isinstance(event, PoseFix) and time > 15.0:
        return event._replace(pose=event.pose + np.array([5.0, -3.0, 0.0]))
    return event


def _compass_turned(event: Event, time: float) -> Event:
    """Turn the compass by 1.5 rad from 15 s to 35 s."""
    if isinstance(event, CompassYaw) and 15.0 < time < 35.0:
        return event._replace(yaw=event.yaw + 1.5)
    return event


def _wheel_too_large(event: Event, time: float) -> Event:
    """Let the left wheel count 30 % too much."""
    if isinstance(event, WheelCount) and event.wheel is Wheel.LEFT:
        return event._replace(reading=round(1.3 * event.reading))
    return event


def _outliers(event: Event, time: float) -> Event:
    """Shift single fixes, and a few in a row."""
    period = round(time / 0.375)
    if isinstance(event, PoseFix) and (period % 17 == 0 or 60 <= period < 65):
        return event._replace(pose=event.pose + np.array([-2.0, 4.0, 0.3]))
    return event


def _pose_set(event: Event, time: float) -> Event:
    """Set a pose, 1 m off, in place of the fix at 15 s."""
    if isinstance(event, PoseFix) and 15.0 <= time < 15.375:
        return PoseReset(
            event.stamp_ns, event.pose + np.array([1.0, 0.0, 0.2]), np.diag([0.3, 0.3, 0.1])
        )
    return event


class BagCase(NamedTuple):
    """A bag and the localizer that hears it.

    Attributes:
        bag: its name.
        parameters: of the localizer, where they differ from those beside the bag.
        change: what is done to the events.
        late_s: by how much later fixes and compass arrive [s].
        seconds: how much of the bag is heard [s].
        every: so many periods lie between the estimates that are kept.
    """

    bag: str
    parameters: Mapping[str, Any]
    change: Change = _unchanged
    late_s: float = 0.0
    seconds: float = 45.0
    every: int = 10


JOINT = {"adaptation": "joint", "lasting_errors": False}
"""Mode joint without the filters of lasting errors: what it learns is what is pinned."""
NONE, RQ = ({"adaptation": mode} for mode in ("none", "rq"))
WRONG_NOISE = {
    "process_noise_std": (0.02, 0.02),
    "measurement_noise_std": (0.5, 0.5, 0.67),
    "lrf_yaw_std": 0.67,
}
CASES_OF_BAGS: dict[str, BagCase] = {
    "sim1_joint": BagCase("sim1", JOINT),
    "sim2_joint": BagCase("sim2", JOINT),
    "round_joint": BagCase("round", JOINT),
    "sim1_none": BagCase("sim1", NONE),
    "sim2_rq": BagCase("sim2", RQ, seconds=12.0, every=5),
    "round_rq_wrong_noise": BagCase("round", RQ | WRONG_NOISE, seconds=12.0, every=5),
    "sim2_rq_trained": BagCase("sim2", RQ | {"membership_file": "trained"}),
    "sim2_joint_wrong_noise": BagCase("sim2", JOINT | WRONG_NOISE),
    "sim2_joint_late": BagCase("sim2", JOINT, late_s=0.5),
    "round_joint_laser_yaw": BagCase("round", JOINT | {"lrf_use_yaw": True}),
    "sim1_joint_message_covariance": BagCase(
        "sim1", JOINT | {"lrf_use_yaw": True, "lrf_use_message_covariance": True}
    ),
    "round_none_long_period": BagCase("round", NONE | {"period": 0.75}),
    "round_joint_carried": BagCase("round", JOINT, _carried),
    "round_none_carried": BagCase("round", NONE, _carried),
    "sim1_joint_compass_turned": BagCase("sim1", JOINT, _compass_turned),
    "sim1_joint_wheel_too_large": BagCase("sim1", JOINT, _wheel_too_large),
    "sim2_joint_outliers": BagCase("sim2", JOINT, _outliers),
    "sim1_none_pose_set": BagCase("sim1", NONE, _pose_set),
}


def _parameters(case: BagCase) -> LocalizerParameters:
    beside = read_parameter_file(BAGS / f"{case.bag}.yaml", NODE_NAME)
    return build(LocalizerParameters, beside | dict(case.parameters))


@functools.cache
def _events(bag_name: str) -> tuple[Arrival, ...]:
    """Return what wheels, compass and laser of a bag say."""
    parameters = _parameters(BagCase(bag_name, {}))
    arrivals = []
    with BagReader(BAGS / bag_name) as bag:
        inputs = inputs_in(bag, parameters, TopicNames([]))
        end_ns = bag.start_ns + max(case.seconds for case in CASES_OF_BAGS.values()) * 1e9
        for record in bag.records(set(inputs)):
            if record.time_ns > end_ns:
                break
            found = read_input(
                inputs[record.topic], bag.message(record), record.time_ns, parameters
            )
            assert not isinstance(found, Rejected)
            arrivals += [Arrival(record.time_ns, event) for event in found]
    return tuple(arrivals)


def _heard(case: BagCase, parameters: LocalizerParameters) -> list[Arrival]:
    """Return what a localizer hears: of fixes and compass only what is taken at a period's end."""
    period_ns, late_ns = round(parameters.period * 1e9), round(case.late_s * 1e9)
    arrivals = _events(case.bag)
    start_ns = arrivals[0].now_ns
    heard = []
    for now_ns, event in arrivals:
        is_reading = not isinstance(event, WheelCount)
        if is_reading and event.stamp_ns % period_ns:
            continue
        time = (event.stamp_ns - start_ns) * 1e-9
        changed = case.change(event, time) if time < case.seconds else None
        if changed is not None:
            heard.append(Arrival(now_ns + is_reading * late_ns, changed))
    return sorted(heard, key=lambda arrival: arrival.now_ns)


def bag_results(name: str) -> dict[str, Records]:
    """Return some of the estimates, and the gate's decisions and all reports."""
    case = CASES_OF_BAGS[name]
    parameters = _parameters(case)
    localizer = Localizer(parameters, networks_for(parameters))
    outputs: list[Output] = []
    for now_ns, event in _heard(case, parameters):
        outputs += localizer.add(event, now_ns)
    estimates = [output for output in outputs if output.estimate is not None]
    return {
        "estimates": _estimates(estimates[case.every :: case.every]),
        "decisions": _decisions(outputs),
        "reports": _reports(outputs),
    }


def _estimates(outputs: list[Output]) -> Records:
    rows = []
    for output in outputs:
        state, result = output.estimate.state, output.estimate.result
        rows.append((
            output.stamp_ns, state.mean, state.covariance[UPPER], state.process_noise,
            state.measurement_noise, result.nis, result.sensor_nis, result.mismatch,
        ))  # fmt: skip
    return np.array(rows, [
        ("stamp_ns", "i8"),
        ("mean", "f8", 3),
        ("covariance", "f8", 6),
        ("process_noise", "f8", 2),
        ("measurement_noise", "f8", 4),
        ("nis", "f8"),
        ("sensor_nis", "f8", 2),
        ("mismatch", "f8", 4),
    ])  # fmt: skip


def _decisions(outputs: list[Output]) -> Records:
    """Return what the gate did in each period."""
    rows = []
    for output in outputs:
        result = None if output.estimate is None else output.estimate.result
        rejected, relocated = (False, False), False
        if result is not None:
            rejected, relocated = tuple(result.rejected), bool(result.relocated)
        moved = output.moved is not None
        rows.append((output.stamp_ns, output.estimate is not None, rejected, relocated, moved))
    return np.array(rows, [
        ("stamp_ns", "i8"),
        ("runs", "?"),
        ("rejected", "?", 2),
        ("relocated", "?"),
        ("moved", "?"),
    ])  # fmt: skip


def _reports(outputs: list[Output]) -> Records:
    """Return the levels of all statuses and the suspects' leads; NaN before the filter runs."""
    rows = []
    for output in outputs:
        if output.statuses is None:
            continue
        levels = {status.name: int(status.level) for status in output.statuses}
        (values,) = (dict(status.values) for status in output.statuses if status.name == "filter")
        text = values.get("suspicion [nats]")
        leads = [math.nan] * 3 if text is None else [float(t.split()[-1]) for t in text.split(",")]
        rows.append((output.stamp_ns, *(levels.pop(name) for name in STATUSES), leads))
        assert not levels, f"statuses that are not compared: {', '.join(levels)}"
    levels_of = [(f"level of {name}", "i1") for name in STATUSES]
    return np.array(rows, [("stamp_ns", "i8"), *levels_of, ("leads", "f4", 3)])
