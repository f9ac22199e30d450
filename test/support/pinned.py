# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results of the filter that may not change: computed here, compared by test_pinned.py.

A change of how the core computes must not change what it computes, as long as each sensor is read
once a period, at its end. What the filters of the studies and the pipeline gave is kept in
`pinned.npz`, and holds to 1e-9. Nothing of the core is called directly, so that its functions and
the layout of its arrays may change.

`pinned.npz` is written anew only when the method itself is changed on purpose, by

    python test/support/pinned.py

which names the cases that changed. The same code and the same libraries write the same bytes.
The simulated recordings are computed each time: if all cases of `study` change and none of `bag`,
the simulation has changed and not the filter.
"""

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from places import BAGS

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.messages.reading import read_input
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.recordings.inputs import TopicNames, inputs_in
from fnn_ekf_ros.study.filters import study_filters
from fnn_ekf_ros.study.recording import Recording, Start
from fnn_ekf_ros.study.scenarios import (
    NOMINAL,
    NOMINAL_MEASUREMENT_NOISE,
    Drive,
    Scenario,
    drive,
    sense,
)
from fnn_ekf_ros.study.starts import CORNERS, RIGHT, starts
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

FILE = Path(__file__).with_name("pinned.npz")
TOLERANCE = 1e-9
LEAD_DIGIT = 0.1
"""Diagnostics show the suspects' leads to one digit after the point [nats]."""
BITS = 40
"""Numbers are kept to so many, a part of 1e-12: the others fill the file and say nothing."""
STEPS, RUNS, SEED = 150, 2, 11
CARRIED = 60
"""The step after which the robot is carried, where other faults begin as well."""
KEPT_STEPS = (5, 25, 50, CARRIED + 5, *range(75, STEPS + 1, 25))
"""Steps after which results of a study are kept."""
UNSTABLE = ("rq_published", "rq_centroid")
"""With the paper's own sets, mode rq lets a difference grow tenfold in about ten steps: one of
1e-14 is beyond 1e-9 after fifty. Only the first steps of these filters can be compared."""
FIRST_STEPS = (5, 10, 15, 20, 25, 30)
"""Steps after which their results are kept."""
UPPER = np.triu_indices(3)
STATUSES = ("encoders", "compass", "lrf_pose", "filter", "time")

Records = NDArray[Any]
"""A structured array; the first field says when."""


# Studies


class StudyCase(NamedTuple):
    """Recordings and starts, and the filters that are run on them.

    Attributes:
        filters: their names.
        path: that the robot drives.
        scenario: what goes wrong.
        carried: by how much fixes and truth are displaced after step `CARRIED`, x and y [m].
        start_error: of the start pose (m, m, rad).
        parameters: of the filters, where they differ from the study's.
    """

    filters: tuple[str, ...]
    path: str = "sim1"
    scenario: Scenario = NOMINAL
    carried: float = 0.0
    start_error: tuple[float, float, float] = (0.0, 0.0, 0.0)
    parameters: Mapping[str, Any] = {}


ALL = (
    "ekf", "ekf_gated", "oracle", "joint", "rq_published", "rq_trained", "r_published",
    "q_trained", "rq_centroid",
)  # fmt: skip
GATED = ("ekf_gated", "joint")
STUDIES = {
    "sim1": StudyCase(ALL),
    "sim2": StudyCase(ALL, path="sim2"),
    "slip": StudyCase(("oracle", "joint", "rq_trained"), scenario=Scenario(process_scale=100.0)),
    "outliers": StudyCase(GATED, scenario=Scenario(outlier_share=0.05, outlier_scale=10.0)),
    "compass_bias": StudyCase(GATED, scenario=Scenario(compass_bias=1.5)),
    "compass_lost": StudyCase(
        ("ekf_gated", "rq_trained"), scenario=Scenario(lost=(Row.COMPASS_YAW,))
    ),
    "wrong_start": StudyCase(GATED, start_error=(3.0, -2.0, 1.5)),
    "carried": StudyCase(GATED, carried=5.0),
    "motion_of_the_paper": StudyCase(("ekf", "rq_trained"), parameters={"motion_model": "paper"}),
    "short_window": StudyCase(UNSTABLE, parameters={"innovation_window": 8}),
}


@functools.cache
def _driven(path: str, process_scale: float) -> Drive:
    scenario = Scenario(process_scale=process_scale)
    rng = np.random.default_rng(SEED)
    return drive(FakeRobotParameters(path=path), scenario, STEPS, RUNS, rng)


@functools.cache
def _recording(name: str) -> Recording:
    case = STUDIES[name]
    robot = FakeRobotParameters(path=case.path)
    driven = _driven(case.path, case.scenario.process_scale)
    recording = sense(robot, case.scenario, driven, np.random.default_rng(SEED + 1))
    truth, measurement = recording.truth.copy(), recording.measurement.copy()
    truth[CARRIED + 1 :, :, :2] += case.carried
    measurement[CARRIED:, :, [Row.X, Row.Y]] += case.carried
    return recording._replace(truth=truth, measurement=measurement)


def _start(case: StudyCase, recording: Recording) -> Start:
    """Return the right start, and the four with Q and R both wrong by 25."""
    Q = np.square(FakeRobotParameters(path=case.path).slip())
    rng = np.random.default_rng(SEED + 2)
    start = starts(recording, Q, NOMINAL_MEASUREMENT_NOISE, (RIGHT, *CORNERS), rng)
    return start._replace(mean=start.mean + np.array(case.start_error))


def _study(name: str, filter_name: str) -> dict[str, Records]:
    """Return mean, covariance and NIS after the steps that are kept."""
    case = STUDIES[name]
    matching = matching_localizer(FakeRobotParameters(path=case.path))
    filters = study_filters(build(LocalizerParameters, asdict(matching) | dict(case.parameters)))
    recording = _recording(name)
    start = _start(case, recording)
    if filter_name == "oracle":  # knows the noise: all its starts are the same
        start = Start(*(array[:1] for array in start))
    track = filters[filter_name].run(recording, start)
    rows = []
    for step in FIRST_STEPS if filter_name in UNSTABLE else KEPT_STEPS:
        mean, covariance, nis = (array[step - 1] for array in track[:3])
        rows.append((step, mean, covariance[..., *UPPER], nis))
    batch = track.nis.shape[1:]
    track_dtype = [
        ("step", "i8"),
        ("mean", "f8", (*batch, 3)),
        ("covariance", "f8", (*batch, 6)),
        ("nis", "f8", batch),
    ]
    return {"track": np.array(rows, track_dtype)}


# Bags


class Arrival(NamedTuple):
    """An event and the ROS time at which it was recorded [ns]."""

    now_ns: int
    event: Event


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


JOINT, NONE, RQ = ({"adaptation": mode} for mode in ("joint", "none", "rq"))
WRONG_NOISE = {
    "process_noise_std": (0.02, 0.02),
    "measurement_noise_std": (0.5, 0.5, 0.67),
    "lrf_yaw_std": 0.67,
}
CASES_OF_BAGS = {
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


def _bag(name: str) -> dict[str, Records]:
    """Return some of the estimates, and the gate's decisions and all reports."""
    case = CASES_OF_BAGS[name]
    parameters = _parameters(case)
    pipeline = Localizer(parameters, networks_for(parameters))
    outputs: list[Output] = []
    for now_ns, event in _heard(case, parameters):
        outputs += pipeline.add(event, now_ns)
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


# Comparison

CASES = (
    *(f"study/{name}/{each}" for name, case in STUDIES.items() for each in case.filters),
    *(f"bag/{name}" for name in CASES_OF_BAGS),
)


def compute(case: str) -> dict[str, Records]:
    """Return what a case gives now."""
    kind, *names = case.split("/")
    return _study(*names) if kind == "study" else _bag(*names)


def kept(case: str) -> dict[str, Records]:
    """Return what a case gave when the file was written; nothing if it was not there."""
    with np.load(FILE) as file:
        return {
            name.rpartition("/")[2]: file[name]
            for name in file.files
            if name.rpartition("/")[0] == case
        }


def differences(case: str, then: Records, now: Records) -> list[str]:
    """Return a sentence for each quantity that differs by more than it may."""
    if then.dtype != now.dtype or then.shape != now.shape:
        return [f"{case}: {now.shape} records of {now.dtype}, were {then.shape} of {then.dtype}"]
    found = []
    when, *quantities = then.dtype.names
    for quantity in (when, *quantities):
        one, other = then[quantity], now[quantity]
        same = one == other
        if one.dtype.kind == "f":
            close = np.abs(other - one) <= _allowed(quantity, then)
            same = same | close | (np.isnan(one) & np.isnan(other))
        if np.all(same):
            continue
        wrong = np.argwhere(~same)
        index = tuple(wrong[0].tolist())
        where = f"{when} {then[when][index[0]]}"
        inside = f" at {list(index[1:])}" if index[1:] else ""
        found.append(
            f"{case}: {quantity}{inside}, first at {where}, is {other[index].item()!r}, was "
            f"{one[index].item()!r}; {len(wrong)} of {one.size} values differ"
        )
    return found


def _allowed(quantity: str, then: Records) -> FloatArray:
    """Return by how much a quantity may differ, relative to its own scale where it has one."""
    value = np.abs(then[quantity])
    if quantity == "leads":
        return np.full_like(value, 1.01 * LEAD_DIGIT)
    if quantity == "covariance":
        std = np.sqrt(value[..., [0, 3, 5]])
        return TOLERANCE * std[..., UPPER[0]] * std[..., UPPER[1]]
    if quantity in ("process_noise", "measurement_noise"):
        return TOLERANCE * value
    if quantity == "mismatch":
        return TOLERANCE * (value + then["measurement_noise"])
    return TOLERANCE * (1.0 + value)


def _shortened(records: Records) -> Records:
    """Return records whose numbers have `BITS` bits."""
    short = records.copy()
    for quantity in records.dtype.names:
        if records[quantity].dtype == np.float64:
            mantissa, exponent = np.frexp(records[quantity])
            short[quantity] = np.ldexp(np.rint(np.ldexp(mantissa, BITS)), exponent - BITS)
    return short


def main() -> None:
    """Write the file anew and name what changed."""
    new: dict[str, Records] = {}
    for case in CASES:
        parts = compute(case)
        new |= {f"{case}/{part}": records for part, records in parts.items()}
        old = kept(case) if FILE.exists() else {}
        if not old:
            print(f"{case}: new")
            continue
        for part, records in parts.items():
            for line in differences(f"{case}/{part}", old[part], records):
                print(line)
    np.savez_compressed(FILE, **{name: _shortened(records) for name, records in new.items()})
    print(f"{FILE}: {len(CASES)} cases, {FILE.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
