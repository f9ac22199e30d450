# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The start: from measurements, from a given pose, and from a pose that is set on the way."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from localizers import PERIOD_NS, joints_localizer, make_localizer, simulated
from textbook_ekf import textbook_step

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.timeline.events import (
    CompassYaw,
    Estimate,
    Event,
    Level,
    Output,
    PoseFix,
    PoseReset,
    Wheel,
    WheelCount,
)

START_NS = 10 * PERIOD_NS
STEP_NS = 12_500_000
SPEED, RATE = 0.5, 0.6
FORWARD_VARIANCE, TURN_VARIANCE = 0.05**2, math.radians(3.0) ** 2
R = np.square([0.1, 0.1, np.sqrt(0.018)])  # users give the roots
REPORTED = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.02]])


def white_localizer(**changes: Any) -> Localizer:
    """Return a localizer that takes all errors for white, as the textbook does."""
    return joints_localizer(**{"lasting_errors": False, **changes})


def pose_at(stamp_ns: int) -> FloatArray:
    """Return where the robot of these tests is: it drives on a circle from (1, -2)."""
    turn = RATE * (stamp_ns - START_NS) * 1e-9
    radius = SPEED / RATE
    heading = math.remainder(2.0 + turn, 2.0 * math.pi)
    return np.array(
        [
            1.0 + radius * (math.sin(2.0 + turn) - math.sin(2.0)),
            -2.0 - radius * (math.cos(2.0 + turn) - math.cos(2.0)),
            heading,
        ]
    )


def fix(stamp_ns: int, x_error: float = 0.0, y_error: float = 0.0) -> PoseFix:
    error = np.array([x_error, y_error, 0.0])
    return PoseFix(stamp_ns, pose_at(stamp_ns) + error, REPORTED)


def compass(stamp_ns: int, error: float = 0.0) -> CompassYaw:
    return CompassYaw(stamp_ns, float(pose_at(stamp_ns)[2]) + error)


def drive(localizer: Localizer, measurements: Sequence[Event], periods: int) -> list[Output]:
    """Drive on the circle; every measurement comes at its stamp."""
    outputs = []
    waiting = sorted(measurements, key=lambda event: event.stamp_ns)
    for stamp in range(START_NS, START_NS + periods * PERIOD_NS + 1, STEP_NS):
        while waiting and waiting[0].stamp_ns <= stamp:
            outputs += localizer.add(waiting.pop(0), stamp)
        time = (stamp - START_NS) * 1e-9
        for wheel, way in zip(Wheel, (SPEED - 0.3 * RATE, SPEED + 0.3 * RATE), strict=True):
            outputs += localizer.add(WheelCount(stamp, wheel, way * time / 0.025), stamp)
    return outputs


def first_estimate(outputs: list[Output]) -> Estimate:
    """Return the estimate that started the filter; there is one from then on in every period."""
    started = [output.estimate is not None for output in outputs]
    assert started == sorted(started)
    estimate = next(o.estimate for o in outputs if o.estimate is not None)
    assert estimate is not None
    return estimate


def way_and_turn(duration_ns: int) -> FloatArray:
    """Return [dS, dtheta] of the robot over so long."""
    return np.array([SPEED, RATE]) * duration_ns * 1e-9


def wheel_noise(duration_ns: int) -> FloatArray:
    """Return Q for so long, `(2, 2)`."""
    return np.diag([FORWARD_VARIANCE, TURN_VARIANCE]) * (duration_ns / PERIOD_NS)


@pytest.fixture
def carried() -> Callable[[int, FloatArray, int], FloatArray]:
    """The covariance that the textbook's EKF has at an instant, by that of an earlier one."""

    def carry(from_ns: int, P: FloatArray, to_ns: int) -> FloatArray:
        if from_ns == to_ns:
            return P
        control, Q = way_and_turn(to_ns - from_ns), wheel_noise(to_ns - from_ns)
        carried: FloatArray
        _, carried = textbook_step(
            False, pose_at(from_ns), P, control, Q, np.zeros(4), np.eye(4), []
        )
        return carried

    return carry


@pytest.mark.parametrize(
    "measurements",
    [
        [],
        [compass(START_NS + PERIOD_NS * n) for n in range(1, 9)],
        [fix(START_NS + PERIOD_NS * n) for n in range(1, 9)],
    ],
    ids=["nothing", "compass only", "fixes only"],
)
def test_no_estimate_until_position_and_yaw_are_known(measurements: list[Event]) -> None:
    outputs = drive(white_localizer(), measurements, 9)
    assert len(outputs) >= 10
    assert all(output.estimate is None for output in outputs)
    reports = [
        status for o in outputs if o.statuses for status in o.statuses if status.name == "filter"
    ]
    assert reports
    assert all(status.level is Level.WARN for status in reports)
    assert all(status.message.startswith("waiting for") for status in reports)


@pytest.mark.parametrize("speaking", [[], [Wheel.LEFT], [Wheel.RIGHT]])
def test_no_estimate_without_both_wheels(speaking: list[Wheel]) -> None:
    ran, outputs = white_localizer(), []
    for number in range(1, 9):
        stamp = START_NS + number * PERIOD_NS
        for wheel in speaking:
            outputs += ran.add(WheelCount(stamp, wheel, 0.0), stamp)
        for event in (fix(stamp), compass(stamp)):
            outputs += ran.add(event, stamp)
    assert len(outputs) >= 5
    assert all(output.estimate is None for output in outputs)


def test_what_is_missing_is_named() -> None:
    def message(measurements: list[Event]) -> str:
        ran = white_localizer()
        drive(ran, measurements, 5)
        return next(s.message for s in ran.report() if s.name == "filter")

    later = START_NS + 2 * PERIOD_NS
    assert message([]) == "waiting for the first position; waiting for the first yaw"
    assert message([fix(later)]) == "waiting for the first yaw"
    assert message([compass(later)]) == "waiting for the first position"


@pytest.mark.parametrize("offset", [0, -100_000_000])
def test_it_starts_with_the_covariance_of_the_measurements(carried: Any, offset: int) -> None:
    """At their time; from there to the period's end it is a filter as any other."""
    stamp = START_NS + 3 * PERIOD_NS + offset
    estimate = first_estimate(drive(white_localizer(), [fix(stamp), compass(stamp)], 6))
    assert estimate.stamp_ns == START_NS + 3 * PERIOD_NS
    expected = carried(stamp, np.diag(R), estimate.stamp_ns)
    np.testing.assert_allclose(estimate.state.covariance, expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(estimate.state.mean, pose_at(estimate.stamp_ns), atol=1e-9)
    np.testing.assert_allclose(estimate.twist, [SPEED, RATE], atol=1e-9)
    assert estimate.result is None


@pytest.mark.parametrize("apart", [1, 2, 5, 20])
@pytest.mark.parametrize("first", ["fix", "compass"])
def test_measurements_that_never_share_a_period_are_carried_by_the_wheels(
    carried: Any, apart: int, first: str
) -> None:
    early = START_NS + 2 * PERIOD_NS - 80_000_000
    late = START_NS + (2 + apart) * PERIOD_NS - 200_000_000
    measurements: list[Event] = [fix(early), compass(late)]
    if first == "compass":
        measurements = [compass(early), fix(late)]
    outputs = drive(white_localizer(), measurements, apart + 6)
    estimate = first_estimate(outputs)
    assert estimate.stamp_ns == START_NS + (2 + apart) * PERIOD_NS
    np.testing.assert_allclose(estimate.state.mean, pose_at(estimate.stamp_ns), atol=1e-9)
    expected = R.copy()
    periods = (late - early) / PERIOD_NS  # until it can start, which it then does
    if first == "fix":
        expected[:2] += periods * FORWARD_VARIANCE
    else:
        expected[2] += periods * TURN_VARIANCE
    expected = carried(late, np.diag(expected), estimate.stamp_ns)
    np.testing.assert_allclose(estimate.state.covariance, expected, rtol=1e-9, atol=1e-15)
    for output in outputs:
        if output.estimate is not None:
            truth = pose_at(output.stamp_ns)
            np.testing.assert_allclose(output.estimate.state.mean, truth, atol=1e-9)


def test_while_waiting_the_newest_of_each_counts() -> None:
    wrong = PoseFix(START_NS + PERIOD_NS, np.array([50.0, 60.0, 0.0]), REPORTED)
    start = START_NS + 5 * PERIOD_NS
    estimate = first_estimate(
        drive(white_localizer(), [wrong, fix(start - PERIOD_NS), compass(start)], 7)
    )
    np.testing.assert_allclose(estimate.state.mean, pose_at(start), atol=1e-9)
    np.testing.assert_allclose(estimate.state.covariance[0, 0], R[0] + FORWARD_VARIANCE)


@pytest.mark.parametrize("yaw", [math.pi, -math.pi, math.pi - 1e-12, -3.0, 3.0])
def test_the_starting_yaw_is_wrapped(yaw: float) -> None:
    stamp = START_NS + 2 * PERIOD_NS
    measurements = [fix(stamp), CompassYaw(stamp, yaw)]
    estimate = first_estimate(drive(white_localizer(compass_offset=1.0), measurements, 3))
    wrapped = float(estimate.state.mean[2])
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(yaw + 1.0))
    assert math.sin(wrapped) == pytest.approx(math.sin(yaw + 1.0))


def test_fixes_with_yaw_start_it_alone() -> None:
    stamp = START_NS + 2 * PERIOD_NS
    ran = white_localizer(lrf_use_yaw=True, lrf_yaw_std=0.2)
    estimate = first_estimate(drive(ran, [fix(stamp)], 5))
    assert estimate.stamp_ns == stamp
    np.testing.assert_allclose(estimate.state.mean, pose_at(stamp), atol=1e-9)
    np.testing.assert_allclose(np.diag(estimate.state.covariance), [R[0], R[1], 0.04])


@pytest.mark.parametrize("use_yaw", [False, True])
def test_reported_covariances_start_it_where_they_are_used(use_yaw: bool) -> None:
    stamp = START_NS + 2 * PERIOD_NS
    ran = white_localizer(lrf_use_message_covariance=True, lrf_use_yaw=use_yaw)
    measurements: list[Event] = [fix(stamp)] if use_yaw else [fix(stamp), compass(stamp)]
    estimate = first_estimate(drive(ran, measurements, 4))
    expected = REPORTED.copy()
    expected[2, 2] = REPORTED[2, 2] if use_yaw else R[2]
    np.testing.assert_allclose(estimate.state.covariance, expected)


@pytest.mark.parametrize("given", [False, True])
def test_start_from_readings_has_their_lasting_errors(given: bool) -> None:
    """A pose that is given does not."""
    stamp = START_NS + 2 * PERIOD_NS
    pose = {"initial_pose": list(pose_at(START_NS)), "initial_pose_std": [0.1, 0.1, 0.1]}
    events: list[Event] = [] if given else [fix(stamp), compass(stamp)]
    white, lasting = (
        first_estimate(drive(joints_localizer(lasting_errors=each, **(pose if given else {})),
                             events, 4)).state
        for each in (False, True)
    )  # fmt: skip
    np.testing.assert_allclose(lasting.mean, white.mean, atol=1e-2)
    ratio = np.diag(lasting.covariance) / np.diag(white.covariance)
    assert np.all(ratio < 1.1) if given else np.all(ratio[:2] > 2.0)


def test_from_an_initial_pose_it_starts_when_both_wheels_are_known() -> None:
    std = [0.3, 0.2, 0.1]
    ran = white_localizer(initial_pose=list(pose_at(START_NS)), initial_pose_std=std)
    outputs = drive(ran, [], 6)
    estimate = first_estimate(outputs)
    assert estimate.stamp_ns == START_NS
    assert estimate.state.covariance[2, 2] == pytest.approx(0.1**2 + TURN_VARIANCE)
    assert estimate.result is not None
    for output in outputs:
        if output.estimate is not None:
            truth = pose_at(output.stamp_ns)
            np.testing.assert_allclose(output.estimate.state.mean, truth, atol=1e-9)


@pytest.mark.parametrize("speaking", [[], [Wheel.LEFT], [Wheel.RIGHT]])
def test_a_given_pose_does_not_age_before_both_wheels_have_spoken(speaking: list[Wheel]) -> None:
    ran = white_localizer(initial_pose=[1.0, -2.0, 2.0], initial_pose_std=[0.3, 0.2, 0.1])
    outputs = []
    for number in range(-400, 0):
        stamp = START_NS + number * PERIOD_NS // 10
        for wheel in speaking:
            outputs += ran.add(WheelCount(stamp, wheel, 0.0), stamp)
        outputs += ran.advance(stamp)
    assert len(outputs) > 35
    assert all(output.estimate is None for output in outputs)
    filter_status = next(s for s in ran.report() if s.name == "filter")
    assert filter_status.level is Level.WARN
    assert filter_status.message == "waiting for the first " + (
        "period of both wheels" if speaking else "wheel counts"
    )
    first = first_estimate(outputs + drive(ran, [], 3))
    assert first.stamp_ns == START_NS
    assert first.state.covariance[2, 2] == pytest.approx(0.1**2 + TURN_VARIANCE)


@pytest.mark.parametrize("running", [False, True])
def test_a_set_pose_counts_from_its_stamp_on(carried: Any, running: bool) -> None:
    elsewhere = {"initial_pose": [40.0, 50.0, 1.0]} if running else {}
    stamp = START_NS + 4 * PERIOD_NS - 130_000_000
    given = np.diag([0.25, 0.25, 0.07])
    outputs = drive(white_localizer(**elsewhere), [PoseReset(stamp, pose_at(stamp), given)], 8)
    known = [o for o in outputs if o.stamp_ns >= stamp]
    assert len(known) == 5
    for output in known:
        assert output.estimate is not None
        truth = pose_at(output.stamp_ns)
        np.testing.assert_allclose(output.estimate.state.mean, truth, atol=1e-9)
    assert known[0].estimate is not None
    expected = carried(stamp, given, known[0].stamp_ns)
    np.testing.assert_allclose(known[0].estimate.state.covariance, expected, rtol=1e-9, atol=1e-15)
    for output in outputs[: -len(known)]:
        assert (output.estimate is not None) is (running and output.stamp_ns >= START_NS)


def taken(
    x: FloatArray,
    P: FloatArray,
    from_ns: int,
    events: Sequence[Event],
    to_ns: int,
) -> tuple[FloatArray, FloatArray]:
    """Return what the textbook's EKF makes of readings in order, at an instant after the last."""
    R4 = np.diag([*R, R[2]])
    for event in [*events, None]:
        stamp = to_ns if event is None else event.stamp_ns
        z, rows = np.zeros(4), []
        if isinstance(event, CompassYaw):
            z[2], rows = event.yaw, [2]
        elif isinstance(event, PoseFix):
            z[:2], rows = event.pose[:2], [0, 1]
        control, Q = way_and_turn(stamp - from_ns), wheel_noise(stamp - from_ns)
        x, P = textbook_step(False, x, P, control, Q, z, R4, rows)
        from_ns = stamp
    return x, P


def test_a_filter_that_starts_goes_on_with_the_readings_that_follow_in_the_same_period() -> None:
    end = START_NS + 4 * PERIOD_NS
    began = end - 250_000_000
    rest: list[Event] = [
        compass(end - 200_000_000, 0.2),
        fix(end - 150_000_000, 0.2, -0.1),
        compass(end - 50_000_000, -0.1),
    ]
    first = [compass(began), fix(began)]
    ran = white_localizer(adaptation="none")
    estimate = first_estimate(drive(ran, [*first, *rest], 6))
    assert estimate.stamp_ns == end
    x, P = taken(pose_at(began), np.diag(R), began, rest, end)
    np.testing.assert_allclose(estimate.state.mean, x, atol=1e-9)
    np.testing.assert_allclose(estimate.state.covariance, P, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("running", [False, True])
def test_a_set_pose_is_corrected_by_the_readings_after_it_and_by_none_before(running: bool) -> None:
    elsewhere = {"initial_pose": [40.0, 50.0, 1.0]} if running else {}
    end = START_NS + 4 * PERIOD_NS
    stamp = end - 200_000_000
    given, P_given = pose_at(stamp), np.diag([0.25, 0.25, 0.07])
    before: list[Event] = [
        compass(stamp - 100_000_000, 0.5),
        fix(stamp - 60_000_000, 1.0, 1.0),
        compass(stamp, 0.4),  # at its instant: before it
    ]
    after: list[Event] = [
        fix(stamp + 50_000_000, 0.2, -0.1),
        compass(stamp + 100_000_000, -0.1),
    ]
    events = [*before, *after, PoseReset(stamp, given, P_given)]
    outputs = drive(white_localizer(adaptation="none", **elsewhere), events, 6)
    estimate = next(o.estimate for o in outputs if o.stamp_ns == end)
    assert estimate is not None
    x, P = taken(given, P_given, stamp, after, end)
    np.testing.assert_allclose(estimate.state.mean, x, atol=1e-9)
    np.testing.assert_allclose(estimate.state.covariance, P, rtol=1e-7, atol=1e-12)


def test_readings_before_a_set_pose_are_taken_before_it() -> None:
    """They are shown as any others, and the noise that they teach is kept."""
    end = START_NS + 4 * PERIOD_NS
    reset = PoseReset(end - 100_000_000, pose_at(end - 100_000_000), np.eye(3))
    events = [compass(end - 200_000_000), fix(end - 150_000_000), compass(end - 50_000_000), reset]
    ran = white_localizer(initial_pose=list(pose_at(START_NS)), initial_pose_std=[0.1, 0.1, 0.1])
    estimate = next(o.estimate for o in drive(ran, events, 6) if o.stamp_ns == end)
    assert estimate is not None
    assert estimate.result is not None
    assert estimate.result.degrees_of_freedom == 3


def test_a_set_pose_keeps_the_adapted_noise() -> None:
    ran = make_localizer(adaptation="r", measurement_noise_std=[0.5, 0.5, 0.6])
    run = simulated(11, 30.0)
    outputs = [o for now, event in run.arrivals for o in ran.add(event, now)]
    before = outputs[-1].estimate
    assert before is not None
    assert np.all(before.state.measurement_noise[:3] < 0.7 * np.array([0.25, 0.25, 0.36]))
    now, last = run.arrivals[-1].now_ns, outputs[-1].stamp_ns
    ran.add(PoseReset(last + 1, np.array([7.0, 8.0, 0.5]), np.eye(3)), now)
    (after,) = ran.advance(last + PERIOD_NS + 500_000_000)
    assert after.estimate is not None
    assert np.linalg.norm(after.estimate.state.mean[:2] - [7.0, 8.0]) < 0.3
    np.testing.assert_allclose(
        after.estimate.state.measurement_noise, before.state.measurement_noise, rtol=0.5
    )
