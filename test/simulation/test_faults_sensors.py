# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Faults of what is measured, and of when it is sent."""

import math

import numpy as np
import pytest
from fault_drives import (
    LASTING,
    counts,
    drive,
    faulty_and_true,
    off,
    on,
    plain,
    pose,
    same,
    through,
    within,
)

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import (
    BadCovariance,
    Bias,
    Burst,
    ClockJump,
    Delay,
    Dropout,
    Duplicates,
    Fault,
    Frozen,
    Misplaced,
    Noise,
    NotANumber,
    Outliers,
    Reordered,
    Wander,
    WrongFrame,
    WrongStamp,
    WrongUnit,
    ZeroQuaternion,
)
from fnn_ekf_ros.parameters.schema import ParameterError
from fnn_ekf_ros.simulation.fake_robot import FakeRobot
from fnn_ekf_ros.simulation.robot import STEP_S

# What is measured.


def test_outliers_of_fixes_have_their_share_size_and_every_direction() -> None:
    count = 4000
    one, heard = through(Outliers(start=0.0, topic="lrf_pose", size=20.0, rate=0.1), count)
    change = off(heard, [one] * count)
    far = np.linalg.norm(change[:, :2], axis=1)
    hit = far > 0.0
    np.testing.assert_allclose(far[hit], 20.0, atol=1e-9)
    np.testing.assert_array_equal(change[:, 2], 0.0)
    assert abs(np.sum(hit) - 0.1 * count) < 6.0 * math.sqrt(count * 0.1 * 0.9)
    mean = np.mean(change[hit, :2] / 20.0, axis=0)
    assert np.max(np.abs(mean)) < 6.0 / math.sqrt(2.0 * np.sum(hit))


def test_outliers_of_the_compass_go_to_either_side() -> None:
    count = 4000
    one, heard = through(Outliers(start=0.0, topic="compass", size=0.7, rate=0.3), count)
    turn = off(heard, [one] * count)[:, 2]
    hit = np.abs(turn) > 1e-9
    np.testing.assert_allclose(np.abs(turn[hit]), 0.7, atol=1e-9)
    assert abs(np.mean(hit) - 0.3) < 6.0 * math.sqrt(0.3 * 0.7 / count)
    assert abs(np.mean(turn[hit] > 0.0) - 0.5) < 3.0 / math.sqrt(np.sum(hit))


def test_part_of_the_messages_is_dropped() -> None:
    _, heard = through(Dropout(start=0.0, topic="compass", rate=0.3), 4000)
    assert abs(len(heard) - 0.7 * 4000) < 6.0 * math.sqrt(4000 * 0.3 * 0.7)


def test_a_bias_is_the_same_for_all() -> None:
    change = off(*faulty_and_true(Bias(topic="lrf_pose", size=(1.0, -2.0, 0.3), **LASTING)))
    np.testing.assert_allclose(change, np.tile([1.0, -2.0, 0.3], (len(change), 1)), atol=1e-9)
    change = off(*faulty_and_true(Bias(topic="compass", size=(0.0, 0.0, -3.0), **LASTING)))
    np.testing.assert_allclose(change[:, 2], -3.0, atol=1e-9)


@pytest.mark.parametrize("topic", ["lrf_pose", "compass"])
def test_noise_is_the_same_noise_times_the_factor(topic: str) -> None:
    fault = Noise(start=0.0, topic=topic, factor=2.5)
    errors = []
    for faults in ([], [fault]):
        run = drive(9.0, faults)
        truth = {e.time: e for e in on(run, "ground_truth")}
        own = on(run, topic)
        errors.append(off(own, [truth[e.time] for e in own]))
        said = own[0].fields if topic == "compass" else own[0].fields["pose"].fields
        name = "orientation_covariance" if topic == "compass" else "covariance"
        assert said[name][-1] == pytest.approx(0.018, rel=0.01)  # the sensor does not know
    np.testing.assert_allclose(errors[1], 2.5 * errors[0], atol=1e-9)


def test_misplaced_fixes_have_their_share_and_lie_about_their_place() -> None:
    count, place = 4000, np.array([3.0, -2.0])
    fault = Misplaced(start=0.0, topic="lrf_pose", place=tuple(place), spread=0.1, rate=0.25)
    one, heard = through(fault, count)
    true = pose(one)
    away = np.array([pose(each) for each in heard]) - true
    hit = np.any(away != 0.0, axis=1)
    assert abs(np.sum(hit) - 0.25 * count) < 6.0 * math.sqrt(count * 0.25 * 0.75)
    apart = (away + true)[hit, :2] - place
    np.testing.assert_allclose(apart.mean(axis=0), 0.0, atol=6.0 * 0.1 / math.sqrt(np.sum(hit)))
    np.testing.assert_allclose(apart.std(axis=0), 0.1, rtol=6.0 / math.sqrt(2.0 * np.sum(hit)))
    np.testing.assert_array_equal(away[:, 2], 0.0)


def test_bias_with_a_rate_is_that_of_one_of_two_sources() -> None:
    count = 4000
    one, heard = through(Bias(start=0.0, topic="lrf_pose", size=(0.5, 0.0, 0.0), rate=0.5), count)
    change = off(heard, [one] * count)[:, 0]
    np.testing.assert_allclose(np.unique(np.round(change, 9)), [0.0, 0.5])
    assert abs(np.mean(change) - 0.25) < 6.0 * 0.25 / math.sqrt(count)


def test_error_that_wanders_has_its_size_and_time_constant() -> None:
    """Gauss-Markov: var = std^2 in the long run, correlation exp(-t / tau); it begins at 0."""
    tau, step_s = 0.1, STEP_S
    count = 12000
    fault = Wander(start=0.0, topic="lrf_pose", std=2.0, time_constant=tau)
    one, heard = through(fault, count)
    error = off(heard, [one] * count)
    assert np.all(np.abs(error[0, :2]) < 6.0 * 2.0 * math.sqrt(2.0 * step_s / tau))
    independent = count * step_s / (2.0 * tau)
    np.testing.assert_allclose(error[:, :2].std(axis=0), 2.0, rtol=6.0 / math.sqrt(2 * independent))
    lag = round(tau / step_s)
    for e in error[:, :2].T:
        correlation = np.mean(e[:-lag] * e[lag:]) / np.mean(e * e)
        assert abs(correlation - math.exp(-1.0)) < 6.0 / math.sqrt(independent)
    np.testing.assert_array_equal(error[:, 2], 0.0)


@pytest.mark.parametrize("topic", ["lrf_pose", "compass", "joint_states", "left_ticks"])
def test_what_is_frozen_repeats_the_last_value_with_new_stamps(topic: str) -> None:
    heard = on(drive(9.0, [Frozen(topic=topic, **LASTING)]), topic)
    last = [e for e in heard if e.time < 4.0][-1]
    frozen = within(heard)
    assert len(frozen) >= 5
    for entry in frozen:
        kept, now = dict(last.fields), dict(entry.fields)
        if topic != "left_ticks":
            assert entry.stamp == pytest.approx(entry.time, abs=1e-9)
            kept.pop("header"), now.pop("header")
        assert plain(Message("", kept)) == plain(Message("", now))


def test_what_is_frozen_from_the_start_repeats_its_first_value() -> None:
    assert set(counts(drive(2.0, [Frozen(start=0.0, topic="left_ticks")]))) == {
        counts(drive(2.0))[0]
    }


@pytest.mark.parametrize(("topic", "axes"), [("lrf_pose", [0, 1]), ("compass", [2])])
def test_what_is_frozen_with_jitter_scatters_about_the_last_value(
    topic: str, axes: list[int]
) -> None:
    lasting = {"start": 4.0, "duration": 30.0}
    heard = on(drive(35.0, [Frozen(topic=topic, jitter=1e-3, **lasting)]), topic)
    last = [e for e in heard if e.time < 4.0][-1]
    frozen = within(heard, 4.0, 34.0)
    change = off(frozen, [last] * len(frozen))
    others = [axis for axis in range(3) if axis not in axes and topic == "lrf_pose"]
    np.testing.assert_allclose(change[:, others], 0.0, atol=1e-12)
    scatter = np.sqrt(np.mean(change[:, axes] ** 2))
    assert abs(scatter / 1e-3 - 1.0) < 4.0 / np.sqrt(2.0 * len(frozen) * len(axes))


def test_a_jitter_of_the_encoders_is_refused() -> None:
    with pytest.raises(ParameterError, match="jitter"):
        Frozen(start=1.0, topic="left_ticks", jitter=1e-3)


def test_not_a_number_stands_where_it_should() -> None:
    for entry in faulty_and_true(NotANumber(topic="lrf_pose", **LASTING))[0]:
        np.testing.assert_array_equal(np.isnan(pose(entry)), [True, False, False])
    for entry in faulty_and_true(NotANumber(topic="compass", **LASTING))[0]:
        assert all(map(math.isnan, entry.fields["orientation"].fields.values()))
    for entry in faulty_and_true(NotANumber(topic="joint_states", **LASTING))[0]:
        assert np.all(np.isnan(entry.fields["position"]))


@pytest.mark.parametrize("topic", ["lrf_pose", "compass"])
def test_a_zero_quaternion_is_zero_and_stays_so_under_other_faults(topic: str) -> None:
    also = Bias(topic=topic, size=(0.0, 0.0, 1.0), **LASTING)
    for faults in ([], [also]):
        heard = drive(9.0, [ZeroQuaternion(topic=topic, **LASTING), *faults])
        for entry in within(on(heard, topic)):
            whole = entry.fields if topic == "compass" else entry.fields["pose"].fields["pose"]
            q = (whole if topic == "compass" else whole.fields)["orientation"].fields
            assert set(q.values()) == {0.0}


def test_a_wrong_frame_is_all_that_is_wrong() -> None:
    wrong, true = faulty_and_true(WrongFrame(topic="lrf_pose", frame="attic", **LASTING))
    assert {e.fields["header"].fields["frame_id"] for e in wrong} == {"attic"}
    np.testing.assert_array_equal(off(wrong, true), 0.0)


def test_a_wrong_unit_multiplies() -> None:
    wrong, true = faulty_and_true(WrongUnit(topic="lrf_pose", **LASTING))
    for one, other in zip(wrong, true, strict=True):
        np.testing.assert_allclose(pose(one), pose(other) * [1000.0, 1000.0, 1.0])
    wrong, true = faulty_and_true(WrongUnit(topic="joint_states", factor=57.3, **LASTING))
    for one, other in zip(wrong, true, strict=True):
        np.testing.assert_allclose(one.fields["position"], other.fields["position"] * 57.3)
    wrong, true = faulty_and_true(WrongUnit(topic="compass", factor=57.3, **LASTING))
    for one, other in zip(wrong, true, strict=True):
        error = float(wrap_angle(pose(one)[2] - 57.3 * wrap_angle(pose(other)[2])))
        assert error == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("size", [0.5, -0.25])
@pytest.mark.parametrize("topic", ["lrf_pose", "compass", "joint_states"])
@pytest.mark.slow
def test_a_wrong_stamp_is_off_by_its_size(topic: str, size: float) -> None:
    wrong, true = faulty_and_true(WrongStamp(topic=topic, size=size, **LASTING))
    assert [e.time for e in wrong] == [e.time for e in true]
    for entry in wrong:
        assert entry.stamp - entry.time == pytest.approx(size, abs=1e-9)


def test_a_stamp_is_never_before_time_zero() -> None:
    (wrong, *_), _ = faulty_and_true(WrongStamp(topic="compass", size=-1e9, **LASTING))
    assert wrong.fields["header"].fields["stamp"].fields == {"sec": 0, "nanosec": 0}


@pytest.mark.parametrize(
    "fault",
    [WrongStamp(start=0.0, topic="compass", size=1e9), ClockJump(start=0.0, size=1e9)],
    ids=lambda fault: type(fault).__name__,
)
def test_seconds_of_a_stamp_fit_their_32_bits(fault: Fault) -> None:
    robot = FakeRobot(FakeRobotParameters(), 1_790_000_000 * 10**9, [fault])
    sent = [entry for _ in range(80) for entry in robot.step() if entry.topic == "compass"]
    seconds = [entry.message.fields["header"].fields["stamp"].fields["sec"] for entry in sent]
    assert min(seconds) == 2_100_000_000
    assert max(seconds) <= 2_100_000_001


@pytest.mark.parametrize("variance", [0.0, -1.0])
def test_a_bad_covariance_has_the_variance_on_its_diagonal(variance: float) -> None:
    fix, *_ = faulty_and_true(BadCovariance(topic="lrf_pose", variance=variance, **LASTING))[0]
    said = np.reshape(fix.fields["pose"].fields["covariance"], (6, 6))
    np.testing.assert_array_equal(said, np.diag([variance] * 6))
    yaw, *_ = faulty_and_true(BadCovariance(topic="compass", variance=variance, **LASTING))[0]
    said = np.reshape(yaw.fields["orientation_covariance"], (3, 3))
    np.testing.assert_array_equal(said, np.diag([variance] * 3))


# When it is sent.


@pytest.mark.parametrize("topic", ["lrf_pose", "compass", "left_ticks", "joint_states"])
def test_what_is_dropped_does_not_come(topic: str) -> None:
    without, with_it = drive(9.0), drive(9.0, [Dropout(topic=topic, **LASTING)])
    kept = [e for e in on(without, topic) if not 4.0 <= e.time < 6.0]
    assert same(on(with_it, topic), kept)
    assert len(kept) < len(on(without, topic))


@pytest.mark.parametrize("topic", ["lrf_pose", "compass", "left_ticks"])
@pytest.mark.slow
def test_what_is_delayed_is_sent_later_and_stamped_as_ever(topic: str) -> None:
    """0.31 s are rounded up to whole steps of 12.5 ms."""
    without, with_it = drive(9.0), drive(9.0, [Delay(topic=topic, size=0.31, **LASTING)])
    expected = [
        (e.time + (0.3125 if 4.0 <= e.time < 6.0 else 0.0), plain(e.message))
        for e in on(without, topic)
    ]
    heard = [(e.time, plain(e.message)) for e in on(with_it, topic)]
    expected = [e for e in sorted(expected, key=lambda e: e[0]) if e[0] <= 9.0]
    assert [time for time, _ in heard] == pytest.approx([time for time, _ in expected], abs=1e-9)
    assert sorted(heard) == sorted(heard, key=lambda e: (e[0], e[1]))
    assert sorted(m for _, m in heard) == sorted(m for _, m in expected)
    if topic != "left_ticks":
        for entry in on(with_it, topic):
            assert entry.time - entry.stamp == pytest.approx(
                0.3125 if 4.0 <= entry.stamp < 6.0 - 1e-9 else 0.0, abs=1e-9
            )


def test_a_burst_comes_at_once_in_order() -> None:
    without, with_it = drive(9.0), drive(9.0, [Burst(topic="compass", **LASTING)])
    true, heard = on(without, "compass"), on(with_it, "compass")
    assert [plain(e.message) for e in true] == [plain(e.message) for e in heard]
    for one, other in zip(true, heard, strict=True):
        held = 4.0 <= one.time < 6.0
        assert other.time == pytest.approx(6.0 if held else one.time, abs=1e-9)
    assert sum(4.0 <= e.time < 6.0 for e in true) == 16


def test_pairs_change_places() -> None:
    without, with_it = drive(9.0), drive(9.0, [Reordered(topic="compass", **LASTING)])
    true = [plain(e.message) for e in on(without, "compass")]
    heard = on(with_it, "compass")
    first = next(i for i, e in enumerate(on(without, "compass")) if e.time >= 4.0)
    swapped = true[:]
    for i in range(first, first + 16, 2):
        swapped[i], swapped[i + 1] = true[i + 1], true[i]
    assert [plain(e.message) for e in heard] == swapped
    assert heard[first].time == pytest.approx(heard[first + 1].time)


def test_the_odd_one_of_reordered_messages_comes_at_the_end() -> None:
    heard = on(drive(5.0, [Reordered(start=4.0, duration=0.2, topic="lrf_pose")]), "lrf_pose")
    true = on(drive(5.0), "lrf_pose")
    assert [plain(e.message) for e in heard] == [plain(e.message) for e in true]
    (late,) = [e for e in heard if e.time - e.stamp > 1e-9]
    assert 4.0 <= late.stamp < 4.2
    assert late.time == pytest.approx(4.2, abs=1e-9)


@pytest.mark.parametrize("topic", ["lrf_pose", "right_ticks"])
def test_duplicates_come_twice(topic: str) -> None:
    without, with_it = drive(9.0), drive(9.0, [Duplicates(topic=topic, **LASTING)])
    expected = [e for e in on(without, topic) for _ in range(1 + (4.0 <= e.time < 6.0))]
    assert same(on(with_it, topic), expected)


def test_what_is_measured_goes_wrong_before_its_delivery_whatever_the_order() -> None:
    faults = [
        Delay(topic="lrf_pose", size=0.5, start=0.0),
        Frozen(topic="lrf_pose", **LASTING),
        Outliers(topic="lrf_pose", size=3.0, rate=1.0, **LASTING),
    ]
    heard = on(drive(9.0, faults), "lrf_pose")
    frozen = [pose(e) for e in heard if 4.0 <= e.stamp < 6.0 - 1e-9]
    healthy = [pose(e) for e in heard if e.stamp < 4.0][-1]
    far = [np.linalg.norm((p - healthy)[:2]) for p in frozen]
    np.testing.assert_allclose(far, 3.0, atol=1e-9)
