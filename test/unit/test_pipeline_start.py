"""The start: from measurements, from a given pose, and from a pose that is set on the way."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.pipeline.events import (
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
from fnn_ekf_ros.pipeline.pipeline import Pipeline

PERIOD_NS = 375_000_000
START_NS = 10 * PERIOD_NS
STEP_NS = 12_500_000
SPEED, RATE = 0.5, 0.6
FORWARD_VARIANCE, TURN_VARIANCE = 0.05**2, math.radians(3.0) ** 2
R = np.square([0.1, 0.1, np.sqrt(0.018)])  # users give the roots
REPORTED = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.02]])
MakePipeline = Callable[..., Pipeline]


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


def fix(stamp_ns: int) -> PoseFix:
    return PoseFix(stamp_ns, pose_at(stamp_ns), REPORTED)


def compass(stamp_ns: int) -> CompassYaw:
    return CompassYaw(stamp_ns, float(pose_at(stamp_ns)[2]))


def drive(pipeline: Pipeline, measurements: Sequence[Event], periods: int) -> list[Output]:
    """Drive on the circle; every measurement comes at its stamp."""
    outputs = []
    waiting = sorted(measurements, key=lambda event: event.stamp_ns)
    for stamp in range(START_NS, START_NS + periods * PERIOD_NS + 1, STEP_NS):
        while waiting and waiting[0].stamp_ns <= stamp:
            outputs += pipeline.add(waiting.pop(0), stamp)
        time = (stamp - START_NS) * 1e-9
        for wheel, way in zip(Wheel, (SPEED - 0.3 * RATE, SPEED + 0.3 * RATE), strict=True):
            outputs += pipeline.add(WheelCount(stamp, wheel, way * time / 0.025), stamp)
    return outputs


def first_estimate(outputs: list[Output]) -> Estimate:
    """Return the estimate that started the filter; there is one from then on in every period."""
    started = [output.estimate is not None for output in outputs]
    assert started == sorted(started)
    estimate = next(o.estimate for o in outputs if o.estimate is not None)
    assert estimate is not None
    return estimate


@pytest.fixture
def pipeline(make_pipeline: MakePipeline) -> MakePipeline:
    """Pipelines that listen to joint states, which have no steps."""

    def make(**changes: Any) -> Pipeline:
        return make_pipeline(encoder_source="joint_states", **changes)

    return make


@pytest.mark.parametrize(
    "measurements",
    [
        [],
        [compass(START_NS + PERIOD_NS * n) for n in range(1, 9)],
        [fix(START_NS + PERIOD_NS * n) for n in range(1, 9)],
    ],
    ids=["nothing", "compass only", "fixes only"],
)
def test_no_estimate_until_position_and_yaw_are_known(
    pipeline: MakePipeline, measurements: list[Event]
) -> None:
    outputs = drive(pipeline(), measurements, 9)
    assert len(outputs) >= 10
    assert all(output.estimate is None for output in outputs)
    reports = [
        status for o in outputs if o.health for status in o.health if status.name == "filter"
    ]
    assert reports
    assert all(status.level is Level.WARN for status in reports)
    assert all(status.message.startswith("waiting for") for status in reports)


@pytest.mark.parametrize("speaking", [[], [Wheel.LEFT], [Wheel.RIGHT]])
def test_no_estimate_without_both_wheels(pipeline: MakePipeline, speaking: list[Wheel]) -> None:
    ran, outputs = pipeline(), []
    for number in range(1, 9):
        stamp = START_NS + number * PERIOD_NS
        for wheel in speaking:
            outputs += ran.add(WheelCount(stamp, wheel, 0.0), stamp)
        for event in (fix(stamp), compass(stamp)):
            outputs += ran.add(event, stamp)
    assert len(outputs) >= 5
    assert all(output.estimate is None for output in outputs)


def test_what_is_missing_is_named(pipeline: MakePipeline) -> None:
    def message(measurements: list[Event]) -> str:
        ran = pipeline()
        drive(ran, measurements, 5)
        return next(s.message for s in ran.report() if s.name == "filter")

    later = START_NS + 2 * PERIOD_NS
    assert message([]) == "waiting for the first position and yaw"
    assert message([fix(later)]) == "waiting for the first yaw"
    assert message([compass(later)]) == "waiting for the first position"


@pytest.mark.parametrize("offset", [0, -100_000_000])
def test_it_starts_with_the_covariance_of_the_measurements(
    pipeline: MakePipeline, offset: int
) -> None:
    stamp = START_NS + 3 * PERIOD_NS + offset
    estimate = first_estimate(drive(pipeline(), [fix(stamp), compass(stamp)], 6))
    assert estimate.stamp_ns == START_NS + 3 * PERIOD_NS
    np.testing.assert_array_equal(estimate.state.covariance, np.diag(R))
    np.testing.assert_allclose(estimate.state.mean, pose_at(estimate.stamp_ns), atol=1e-9)
    np.testing.assert_allclose(estimate.twist, [SPEED, RATE], atol=1e-9)
    assert estimate.result is None


@pytest.mark.parametrize("apart", [1, 2, 5, 20])
@pytest.mark.parametrize("first", ["fix", "compass"])
def test_measurements_that_never_share_a_period_are_carried_by_the_wheels(
    pipeline: MakePipeline, apart: int, first: str
) -> None:
    early = START_NS + 2 * PERIOD_NS - 80_000_000
    late = START_NS + (2 + apart) * PERIOD_NS - 200_000_000
    measurements: list[Event] = [fix(early), compass(late)]
    if first == "compass":
        measurements = [compass(early), fix(late)]
    outputs = drive(pipeline(), measurements, apart + 6)
    estimate = first_estimate(outputs)
    assert estimate.stamp_ns == START_NS + (2 + apart) * PERIOD_NS
    np.testing.assert_allclose(estimate.state.mean, pose_at(estimate.stamp_ns), atol=1e-9)
    expected = R.copy()
    if first == "fix":
        expected[:2] += apart * FORWARD_VARIANCE
    else:
        expected[2] += apart * TURN_VARIANCE
    np.testing.assert_allclose(np.diag(estimate.state.covariance), expected, rtol=1e-12)
    for output in outputs:
        if output.estimate is not None:
            truth = pose_at(output.stamp_ns)
            np.testing.assert_allclose(output.estimate.state.mean, truth, atol=1e-9)


def test_while_waiting_the_newest_of_each_counts(pipeline: MakePipeline) -> None:
    wrong = PoseFix(START_NS + PERIOD_NS, np.array([50.0, 60.0, 0.0]), REPORTED)
    start = START_NS + 5 * PERIOD_NS
    estimate = first_estimate(drive(pipeline(), [wrong, fix(start - PERIOD_NS), compass(start)], 7))
    np.testing.assert_allclose(estimate.state.mean, pose_at(start), atol=1e-9)
    np.testing.assert_allclose(estimate.state.covariance[0, 0], R[0] + FORWARD_VARIANCE)


@pytest.mark.parametrize("yaw", [math.pi, -math.pi, math.pi - 1e-12, -3.0, 3.0])
def test_the_starting_yaw_is_wrapped(pipeline: MakePipeline, yaw: float) -> None:
    stamp = START_NS + 2 * PERIOD_NS
    measurements = [fix(stamp), CompassYaw(stamp, yaw)]
    estimate = first_estimate(drive(pipeline(compass_offset=1.0), measurements, 3))
    wrapped = float(estimate.state.mean[2])
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(yaw + 1.0))
    assert math.sin(wrapped) == pytest.approx(math.sin(yaw + 1.0))


def test_fixes_with_yaw_start_it_alone(pipeline: MakePipeline) -> None:
    stamp = START_NS + 2 * PERIOD_NS
    ran = pipeline(lrf_use_yaw=True, lrf_yaw_std=0.2)
    estimate = first_estimate(drive(ran, [fix(stamp)], 5))
    assert estimate.stamp_ns == stamp
    np.testing.assert_allclose(estimate.state.mean, pose_at(stamp), atol=1e-9)
    np.testing.assert_allclose(np.diag(estimate.state.covariance), [R[0], R[1], 0.04])


@pytest.mark.parametrize("use_yaw", [False, True])
def test_reported_covariances_start_it_where_they_are_used(
    pipeline: MakePipeline, use_yaw: bool
) -> None:
    stamp = START_NS + 2 * PERIOD_NS
    ran = pipeline(lrf_use_message_covariance=True, lrf_use_yaw=use_yaw)
    measurements: list[Event] = [fix(stamp)] if use_yaw else [fix(stamp), compass(stamp)]
    estimate = first_estimate(drive(ran, measurements, 4))
    expected = REPORTED.copy()
    expected[2, 2] = REPORTED[2, 2] if use_yaw else R[2]
    np.testing.assert_allclose(estimate.state.covariance, expected)


def test_from_an_initial_pose_it_starts_when_both_wheels_are_known(pipeline: MakePipeline) -> None:
    std = [0.3, 0.2, 0.1]
    ran = pipeline(initial_pose=list(pose_at(START_NS)), initial_pose_std=std)
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
def test_a_given_pose_does_not_age_before_both_wheels_have_spoken(
    pipeline: MakePipeline, speaking: list[Wheel]
) -> None:
    ran = pipeline(initial_pose=[1.0, -2.0, 2.0], initial_pose_std=[0.3, 0.2, 0.1])
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
def test_a_set_pose_counts_from_its_stamp_on(pipeline: MakePipeline, running: bool) -> None:
    elsewhere = {"initial_pose": [40.0, 50.0, 1.0]} if running else {}
    stamp = START_NS + 4 * PERIOD_NS - 130_000_000
    given = np.diag([0.25, 0.25, 0.07])
    outputs = drive(pipeline(**elsewhere), [PoseReset(stamp, pose_at(stamp), given)], 8)
    known = [o for o in outputs if o.stamp_ns >= stamp]
    assert len(known) == 5
    for output in known:
        assert output.estimate is not None
        truth = pose_at(output.stamp_ns)
        np.testing.assert_allclose(output.estimate.state.mean, truth, atol=1e-9)
    assert known[0].estimate is not None
    np.testing.assert_allclose(known[0].estimate.state.covariance, given)
    for output in outputs[: -len(known)]:
        assert (output.estimate is not None) is (running and output.stamp_ns >= START_NS)


def test_a_set_pose_keeps_the_adapted_noise(make_pipeline: MakePipeline, simulated: Any) -> None:
    ran = make_pipeline(adaptation="r", measurement_noise_std=[0.5, 0.5, 0.6])
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
