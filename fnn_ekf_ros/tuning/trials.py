# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Tuning where the truth is known: simulated robots, and the halves of a drive."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import Fault, Wander
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.parameters.paper import SIMULATION_1_STD, SIMULATION_2_STD
from fnn_ekf_ros.simulation.listening import listen
from fnn_ekf_ros.study.real import batch_start, recording_localizer
from fnn_ekf_ros.study.starts import RIGHT
from fnn_ekf_ros.tuning.fit import Progress
from fnn_ekf_ros.tuning.forecasts import poses
from fnn_ekf_ros.tuning.objective import term_values
from fnn_ekf_ros.tuning.quantities import Quantity, coordinates, is_logarithm, scale_of
from fnn_ekf_ros.tuning.recording import TuningRecording, prepare, schedule_of
from fnn_ekf_ros.tuning.tune import FEWEST_FIXES, configured, tune
from fnn_ekf_ros.tuning.uncertainty import QUANTILE

START_NS = 10**12
"""ROS time at which the robots start [ns]."""
START_FACTOR = 2.0
"""Factor on the noise that the search begins with: Q is too large by it, R too small."""
LITTLE_SLIP = (0.005, 0.005)
"""Slip of good ground, per 375 ms (m, rad)."""


class Kind(NamedTuple):
    """A kind of simulated robots.

    Attributes:
        about: what they are.
        path: what is driven.
        slip_std: slip of the wheels, per 375 ms (m, rad).
        faults: of the messages.
        wrong: factors on parameters of the localizer; these are looked for then.
        compass_offset: of the parameters, the true one is 0 [rad].
    """

    about: str
    path: str
    slip_std: tuple[float, float]
    faults: tuple[Fault, ...] = ()
    wrong: tuple[tuple[str, float], ...] = ()
    compass_offset: float = 0.0

    @property
    def calibrates(self) -> bool:
        """Whether geometry, offset and delays are looked for."""
        return bool(self.wrong)


_ERROR = Wander(start=0.0, topic="lrf_pose", duration=1e6, std=0.3, time_constant=10.0)
KINDS = {
    "calibration": Kind(
        "little slip; wheel_radius 2 % too large, wheel_separation 3 % too small, compass_offset "
        "0.1 rad too large",
        "figure_eight", LITTLE_SLIP, (),
        (("wheel_radius", 1.02), ("wheel_separation", 0.97)), 0.1,
    ),
    "lasting": Kind(
        f"little slip; fix errors of {_ERROR.std:g} m that last {_ERROR.time_constant:g} s",
        "figure_eight", LITTLE_SLIP, (_ERROR,),
    ),
    "sim1": Kind("slip of simulation 1", "square", SIMULATION_1_STD),
    "sim2": Kind("slip of simulation 2", "square", SIMULATION_2_STD),
}  # fmt: skip
"""Kinds of simulated robots, by name."""


class Found(NamedTuple):
    """What was found of a quantity.

    Attributes:
        quantity: its name, in lower case.
        error: of the value: relative to the true one, or a difference where it is no factor.
        std: standard error that is stated, of its logarithm or of the value; infinite at a bound.
        covered: whether the 95 % interval has the true value in it.
    """

    quantity: str
    error: float
    std: float
    covered: bool


class Halves(NamedTuple):
    """The noise that a recording's first half tells, beside that of the second.

    Attributes:
        loss: what the first's loses of the second's objective, relative to its size at the optimum;
            less than 0 where the second's fit ended at another optimum, or at a bound.
        loss_nats: the same [nats], with the weights of the second's fit.
        most_different: the quantity in which they differ most; empty if no two are known.
        standard_errors: by how many of the difference's standard errors.
    """

    loss: float
    loss_nats: float
    most_different: str
    standard_errors: float


class Trial(NamedTuple):
    """A robot that was tuned.

    Attributes:
        kind: its kind.
        seed: its seed.
        errors_last: whether errors are said to last.
        found: the quantities, by the model that is shown.
        halves: the halves of its drive beside each other, where that was asked for and can be told.
    """

    kind: str
    seed: int
    errors_last: bool
    found: tuple[Found, ...]
    halves: Halves | None = None


def simulated(kind: Kind, seed: int, duration_s: float) -> tuple[TuningRecording, FloatArray]:
    """Return a simulated recording, with parameters that are wrong, and the true values `(16,)`."""
    robot = FakeRobotParameters(path=kind.path, seed=seed, slip_std=kind.slip_std)
    right = matching_localizer(robot)
    true = configured(right)
    true[[Quantity.DISTANCE, Quantity.ROTATION]] = kind.slip_std
    changed = {name: getattr(right, name) * factor for name, factor in kind.wrong}
    for name, factor in kind.wrong:
        quantity = Quantity.RADIUS if name == "wheel_radius" else Quantity.SEPARATION
        true[quantity] = 1.0 / factor
    true[Quantity.OFFSET] = -kind.compass_offset
    for fault in kind.faults:
        if isinstance(fault, Wander):
            true[[Quantity.FIX_ERROR, Quantity.FIX_TIME]] = fault.std, fault.time_constant
    (distance, rotation), (x, y, yaw) = kind.slip_std, right.measurement_noise_std
    given = dataclasses.replace(
        right,
        process_noise_std=(START_FACTOR * distance, START_FACTOR * rotation),
        measurement_noise_std=(x / START_FACTOR, y / START_FACTOR, yaw / START_FACTOR),
        compass_offset=kind.compass_offset,
        **changed,
    )
    return _listened(given, robot, duration_s, kind.faults), true


def _listened(
    parameters: LocalizerParameters,
    robot: FakeRobotParameters,
    duration_s: float,
    faults: tuple[Fault, ...],
) -> TuningRecording:
    localizer, recorder = recording_localizer(parameters)
    for heard in listen(robot, parameters, START_NS, duration_s, faults):
        localizer.receive(heard.topic, heard.message, heard.now_ns)
    batch = batch_start(parameters, recorder.periods, [RIGHT])
    return prepare("simulated", parameters, batch)


def tune_robot(name: str, seed: int, duration_s: float, *, with_halves: bool = False) -> Trial:
    """Tune a simulated robot.

    Args:
        name: of its kind.
        seed: of it.
        duration_s: how long it drives [s].
        with_halves: whether both halves of its drive are tuned, too, and compared.
    """
    kind = KINDS[name]
    recording, true = simulated(kind, seed, duration_s)
    tuned = tune([recording], calibrates=kind.calibrates, progress=lambda _: None)
    found = []
    for each in tuned.shown.intervals:
        if each.quantity in (Quantity.YAW_ERROR, Quantity.YAW_TIME):
            continue  # there are none: their time is arbitrary
        (right,) = coordinates(true, (each.quantity,))
        difference = each.coordinate - float(right)
        error, scale = float(np.expm1(difference)), 1.0
        if not is_logarithm(each.quantity):
            scale = scale_of(each.quantity)
            error = difference * scale
        found.append(
            Found(
                quantity=each.quantity.name.lower(),
                error=error,
                std=each.std * scale,
                covered=abs(difference) <= QUANTILE * each.std,
            )
        )
    beside = None
    if with_halves:
        beside = compare_halves(recording, lambda _: None, calibrates=kind.calibrates)
    return Trial(name, seed, tuned.errors_last, tuple(found), beside)


def halves(recording: TuningRecording) -> tuple[TuningRecording, TuningRecording]:
    """Return both halves of a recording; the second begins where its readings put the robot."""
    middle = len(recording.duration_s) // 2
    where = poses(_part(recording, slice(0, middle)), configured(recording.parameters)[:, None])
    mean, variance = where.mean[-1, :, 0], where.variance[-1, :, 0]
    second = _part(recording, slice(middle, None))._replace(
        mean=mean, covariance=np.diag(variance), from_readings=False
    )
    return _part(recording, slice(0, middle)), second


def _part(recording: TuningRecording, part: slice) -> TuningRecording:
    control, duration_s = recording.control[:, part], recording.duration_s[part]
    available = recording.available[:, part]
    first = part.start
    last = first + len(duration_s)
    return recording._replace(
        control=control,
        duration_s=duration_s,
        measurement=recording.measurement[:, part],
        available=available,
        reported=recording.reported[:, part],
        resets={at - first: reset for at, reset in recording.resets.items() if first <= at < last},
        schedule=schedule_of(control, duration_s, available[0]),
    )


def compare_halves(
    recording: TuningRecording, progress: Progress, *, calibrates: bool = False
) -> Halves | None:
    """Return how well the noise of a recording's first half fits its second half.

    By the model that the first half shows, with the weights that its fit to the second goes by.

    Args:
        recording: the whole of it.
        progress: is told what is being done.
        calibrates: whether geometry, offset and delays are looked for, too, in each half.

    Returns:
        None where a half has too few fixes to be tuned.
    """
    first, second = halves(recording)
    if min(int(half.available[Row.X].sum()) for half in (first, second)) < FEWEST_FIXES:
        return None
    tuned = tune([first], calibrates=calibrates, progress=progress)
    own = tune([second], calibrates=calibrates, progress=progress)
    of_first, of_second = (
        each.lasting if tuned.errors_last else each.white for each in (tuned, own)
    )
    terms = term_values([second], np.stack([of_first.fit.values, of_second.fit.values], axis=1))
    at_first, optimum = of_second.fit.weights.each() @ terms
    of_second_by_name = {each.quantity: each for each in of_second.intervals}
    known = []
    for one in of_first.intervals:
        other = of_second_by_name.get(one.quantity)  # a sensor may be silent in one half
        std = math.inf if other is None else math.hypot(one.std, other.std)
        if other is not None and math.isfinite(std):
            known.append((abs(one.coordinate - other.coordinate) / std, one.quantity.name.lower()))
    most, quantity = max(known, default=(0.0, ""))
    return Halves(
        loss=float((optimum - at_first) / abs(optimum)),
        loss_nats=float(optimum - at_first),
        most_different=quantity,
        standard_errors=float(most),
    )
