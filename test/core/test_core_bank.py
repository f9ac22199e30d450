import itertools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from fnn_ekf_ros.core.arrays import FloatArray, Row, components_last, diagonal_matrix
from fnn_ekf_ros.core.bank import (
    FIX_ROWS,
    Bank,
    Correction,
    Innovations,
    Noise,
    Readings,
    correct,
    innovate,
    noise_of_readings,
    predict,
    predict_covariance,
    wrapped,
)
from fnn_ekf_ros.core.covariance import limit_uncertainty
from fnn_ekf_ros.core.limits import LARGEST_POSE_STD, SMALLEST_STD
from fnn_ekf_ros.core.motion import MotionModel, move

Covariances = Callable[[np.random.Generator, int, int], FloatArray]
BOTH_MODELS = pytest.mark.parametrize("model", list(MotionModel))
ALL_MASKS = list(itertools.product([False, True], repeat=4))
FIX_MASKS = list(itertools.product([False, True], repeat=3))
ALL_ROWS = np.ones(4, dtype=np.bool_)
NO_ROWS = np.zeros(4, dtype=np.bool_)
STATE_OF_ROW = [0, 1, 2, 2]
FIX = list(FIX_ROWS)
UNIT = (1.0, 1.0, 1.0, 1.0)
H = np.eye(3)[STATE_OF_ROW]
BOTH_KINDS = pytest.mark.parametrize("reported", [False, True], ids=["own noise", "reported noise"])

# Quantiles 0.005 and 0.995 of chi-square with 1500 degrees of freedom, found by bisection on the
# regularised incomplete gamma function (Abramowitz and Stegun, 26.4.19).
CHI_SQUARE_1500 = (1362.674, 1644.838)


def one_filter(mean: Any, covariance: Any) -> Bank:
    """Return a bank of one filter of one robot."""
    return Bank(np.array(mean, dtype=np.float64)[:, None], np.array(covariance)[:, :, None])


def corrected(bank: Bank, z: FloatArray, R: Any, available: Any) -> tuple[Innovations, Correction]:
    """Correct one filter by readings with uncorrelated noise; headings are wrapped."""
    noise = Noise(np.ones((2, 1)), np.array(R, dtype=np.float64)[:, None])
    return corrected_by(bank, Readings(np.asarray(z), np.asarray(available)), noise)


def corrected_by(bank: Bank, readings: Readings, noise: Noise) -> tuple[Innovations, Correction]:
    seen = innovate(bank, readings, noise.measurement)
    taken = correct(bank, seen, noise, readings.available)
    return seen, taken._replace(bank=wrapped(taken.bank))


def all_bytes(parts: Any) -> bytes:
    """Return every bit of arrays, in whatever tuples they are."""
    if isinstance(parts, tuple):
        return b"".join(all_bytes(part) for part in parts)
    return np.ascontiguousarray(parts).tobytes()


def parts(seen: Innovations, taken: Correction) -> list[FloatArray]:
    """Return all arrays of a correction, each with filters and batch as its last dimensions."""
    return [*seen, *taken.bank, taken.nis, taken.fix_nis, taken.determinant]


def assert_symmetric(covariance: FloatArray) -> None:
    assert covariance.tobytes() == np.swapaxes(covariance, 0, 1).tobytes()


def assert_positive_definite(covariance: FloatArray) -> None:
    """In units of its own standard deviations; the Cholesky factorisation refuses what is not."""
    assert np.all(np.isfinite(covariance))
    last = components_last(covariance, 2)
    std = np.sqrt(np.diagonal(last, axis1=-2, axis2=-1))
    np.linalg.cholesky(last / (std[..., :, None] * std[..., None, :]))


class Dense(NamedTuple):
    """What one textbook correction by all rows together gives."""

    mean: FloatArray
    covariance: FloatArray
    nis: float
    determinant: float


def dense(mean: FloatArray, P: FloatArray, z: FloatArray, R: FloatArray, rows: list[int]) -> Dense:
    """Correct with the matrices of some rows, S inverted; an ordinary vector as innovation."""
    if not rows:
        return Dense(mean, P, 0.0, 1.0)
    Hr, S = H[rows], H[rows] @ P @ H[rows].T + R[np.ix_(rows, rows)]
    r = z[rows] - Hr @ mean
    K = P @ Hr.T @ np.linalg.inv(S)
    nis = float(r @ np.linalg.inv(S) @ r)
    return Dense(mean + K @ r, P - K @ Hr @ P, nis, float(np.linalg.det(S)))


def full_noise(fix: FloatArray, compass: float) -> FloatArray:
    """Return R `(4, 4)` of a fix's covariance and the compass' variance."""
    R = np.zeros((4, 4))
    R[np.ix_(FIX, FIX)] = fix
    R[Row.COMPASS_YAW, Row.COMPASS_YAW] = compass
    return R


def test_spinning_robot_equals_linear_kalman_filter() -> None:
    """On the spot, A = I and x, y, theta add up: a linear problem, in information form here."""
    rng = np.random.default_rng(11)
    q, R = 1e-3, np.array([0.02, 0.03, 0.01, 0.04])
    root = 0.2 * rng.standard_normal((3, 3))
    x_kf: Any = np.array([1.0, 2.0, 0.0])
    P_kf: Any = root @ root.T + 0.01 * np.eye(3)
    bank = one_filter(x_kf, P_kf)
    for _ in range(60):
        turn = rng.uniform(-0.02, 0.02)
        z = np.array([1.0, 2.0, 0.0, 0.0]) + rng.standard_normal(4) * np.sqrt(R)
        Q = np.array([[0.0], [q]])
        bank = predict(MotionModel.EXACT_ARC, bank, np.array([0.0, turn]), Q)
        bank = corrected(bank, z, R, ALL_ROWS)[1].bank

        x_kf = x_kf + np.array([0.0, 0.0, turn])
        information = np.linalg.inv(P_kf + np.diag([0.0, 0.0, q]))
        gain_free = information @ x_kf + H.T @ (z / R)
        P_kf = np.linalg.inv(information + H.T @ np.diag(1.0 / R) @ H)
        x_kf = P_kf @ gain_free
        np.testing.assert_allclose(bank.mean[:, 0], x_kf, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(bank.covariance[..., 0], P_kf, rtol=0.0, atol=1e-13)


@BOTH_MODELS
def test_known_heading_equals_linear_kalman_filter(model: MotionModel) -> None:
    """Straight ahead with the heading known, x and y are a linear problem; their noise is one."""
    rng = np.random.default_rng(12)
    heading, way, q = 0.6, 0.3, 4e-4
    along = np.array([math.cos(heading), math.sin(heading)])
    R = np.array([[0.02, 0.005], [0.005, 0.03]])
    fix = np.eye(3)
    fix[:2, :2] = R
    rows = np.array([True, True, False, False])
    noise = noise_of_readings(Noise(np.array([[q], [0.0]]), np.ones((4, 1))), UNIT, fix, rows)
    bank = one_filter([0.0, 0.0, heading], np.diag([0.5, 0.4, 0.0]))
    x_kf, P_kf = bank.mean[:2, 0].copy(), bank.covariance[:2, :2, 0].copy()
    for i in range(60):
        z = (i + 1) * way * along + rng.multivariate_normal(np.zeros(2), R)
        bank = predict(model, bank, np.array([way, 0.0]), noise.process)
        bank = corrected_by(bank, Readings(np.array([*z, 0.0, 0.0]), rows), noise)[1].bank

        x_kf = x_kf + way * along
        P_minus = P_kf + q * np.outer(along, along)
        gain = P_minus @ np.linalg.inv(P_minus + R)
        x_kf, P_kf = x_kf + gain @ (z - x_kf), P_minus - gain @ P_minus
        np.testing.assert_allclose(bank.mean[:, 0], [*x_kf, heading], rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(bank.covariance[:2, :2, 0], P_kf, rtol=0.0, atol=1e-13)
    assert np.all(bank.covariance[2] == 0.0)


@BOTH_MODELS
@BOTH_KINDS
def test_long_random_run_equals_the_textbook_filter(
    model: MotionModel, textbook_step: Any, random_covariances: Covariances, reported: bool
) -> None:
    """Rows one after the other do what all together do, whichever there are."""
    rng = np.random.default_rng(13)
    x, P = np.array([1.0, -2.0, 3.0]), 0.05 * random_covariances(rng, 1, 3)[..., 0]
    bank = one_filter(x, P)
    masks_seen = set()
    for _ in range(400):
        turn = rng.uniform(0.02, 0.5) * rng.choice([-1.0, 1.0])
        control = np.array([rng.uniform(-0.3, 0.6), turn])
        Q, own = rng.uniform(1e-4, 1e-2, 2), rng.uniform(1e-3, 0.1, 4)
        fix = 0.02 * random_covariances(rng, 1, 3)[..., 0] if reported else None
        available = rng.random(4) < 0.5
        z = (
            x[STATE_OF_ROW]
            + 0.3 * rng.standard_normal(4)
            + 2.0 * np.pi * rng.integers(-1, 2, 4) * np.array([0.0, 0.0, 1.0, 1.0])
        )
        rows = [i for i in range(4) if available[i]]
        masks_seen.add(tuple(rows))

        bank = predict(model, bank, control, Q[:, None])
        noise = Noise(Q[:, None], own[:, None])
        noise = noise_of_readings(noise, tuple(own), fix, available)
        bank = corrected_by(bank, Readings(z, available), noise)[1].bank
        R = np.diag(own) if fix is None else full_noise(fix, own[Row.COMPASS_YAW])
        paper = model is MotionModel.PAPER
        x, P = textbook_step(paper, x, P, control, np.diag(Q), z, R, rows)

        np.testing.assert_allclose(bank.mean[:2, 0], x[:2], rtol=0.0, atol=1e-9)
        assert abs(math.remainder(bank.mean[2, 0] - x[2], 2.0 * math.pi)) < 1e-9
        np.testing.assert_allclose(bank.covariance[..., 0], P, rtol=0.0, atol=1e-9)
    assert len(masks_seen) == 16


class Case(NamedTuple):
    """A bank of three filters of 16 robots, to each of which other rows are available."""

    bank: Bank
    noise: Noise
    readings: Readings
    fix: FloatArray


def random_case(rng: np.random.Generator, random_covariances: Covariances, filters: int) -> Case:
    robots = len(ALL_MASKS)
    mean = 0.3 * rng.standard_normal((3, filters, robots))
    P = random_covariances(rng, filters * robots, 3).reshape(3, 3, filters, robots)
    Q, R = np.ones((2, filters, robots)), rng.uniform(0.05, 3.0, (4, filters, robots))
    readings = Readings(0.3 * rng.standard_normal((4, robots)), np.array(ALL_MASKS).T)
    return Case(Bank(mean, P), Noise(Q, R), readings, random_covariances(rng, robots, 3))


@pytest.mark.parametrize("left_over", [0.0, 1e6, math.nan, math.inf])
@BOTH_KINDS
def test_every_subset_of_rows_equals_dense_linear_algebra(
    left_over: float, random_covariances: Covariances, reported: bool
) -> None:
    """Whatever is in the place of a row that was not measured, only the others count.

    Filters have R of their own. What a fix reports is multiplied, row by row, by what theirs are
    to the reference.
    """
    rng = np.random.default_rng(14)
    reference = (0.5, 0.7, 1.0, 2.0)
    for _ in range(4):
        bank, own, (z, available), fix = random_case(rng, random_covariances, 3)
        noise = own
        if reported:
            hidden = ~available[FIX]
            told = np.where(hidden[:, None] | hidden[None], left_over, fix)
            noise = noise_of_readings(own, reference, told, available)
        readings = Readings(np.where(available, z, left_over), available)
        seen, taken = corrected_by(bank, readings, noise)
        assert np.all(np.where(available[:, None], 0.0, seen.innovation) == 0.0)
        for f, i in np.ndindex(taken.nis.shape):
            rows = [row for row in range(4) if available[row, i]]
            mean, P = bank.mean[:, f, i], bank.covariance[:, :, f, i]
            R = np.diag(own.measurement[:, f, i])
            if reported:
                scale = np.sqrt(own.measurement[FIX, f, i] / np.array(reference)[FIX])
                R = full_noise(scale[:, None] * fix[..., i] * scale, R[2, 2])
            expected = dense(mean, P, z[:, i], R, rows)
            got = taken.bank
            np.testing.assert_allclose(got.mean[:, f, i], expected.mean, rtol=0, atol=1e-12)
            np.testing.assert_allclose(
                got.covariance[:, :, f, i], expected.covariance, rtol=0, atol=1e-12
            )
            assert taken.nis[f, i] == pytest.approx(expected.nis, rel=1e-11, abs=1e-14)
            assert taken.determinant[f, i] == pytest.approx(expected.determinant, rel=1e-11)
            of_fix = [row for row in rows if row != Row.COMPASS_YAW]
            alone = dense(mean, P, z[:, i], R, of_fix).nis
            assert taken.fix_nis[f, i] == pytest.approx(alone, rel=1e-11, abs=1e-14)
            np.testing.assert_allclose(
                seen.variance[rows, f, i], np.diag(H @ P @ H.T + R)[rows], rtol=1e-14
            )


def test_innovation_variance_is_the_diagonal_of_S_of_every_row(
    random_covariances: Covariances,
) -> None:
    rng = np.random.default_rng(16)
    bank, noise, readings, _ = random_case(rng, random_covariances, 2)
    seen = innovate(bank, readings, noise.measurement)
    P = np.einsum("ii...->i...", bank.covariance)
    np.testing.assert_array_equal(seen.variance, P[STATE_OF_ROW] + noise.measurement)


@pytest.mark.parametrize("mask", FIX_MASKS, ids=str)
def test_scales_of_a_report_go_row_by_row_and_end_at_the_best_sensor(
    mask: tuple[bool, ...], random_covariances: Covariances
) -> None:
    """C = D R D, D = diag(max(sqrt(R / R_ref), 1e-4 / std)), and the rows are coupled by C's."""
    rng = np.random.default_rng(24)
    available = np.array([mask[0], mask[1], True, mask[2]])
    reference = (0.01, 0.04, 0.02, 0.01)
    fix = random_covariances(rng, 5, 3)
    fix *= 1e-7  # stds of some 0.3 mm: the second filter's scales would make them too good
    own = np.array(reference)[:, None, None] * np.array([[4.0, 1e-6], [0.25, 1e-6], [1.0, 9.0],
                                                         [1e-6, 16.0]])[:, :, None]  # fmt: skip
    own = np.broadcast_to(own, (4, 2, 5))
    noise = noise_of_readings(Noise(np.ones((2, 2, 5)), own), reference, fix, available[:, None] &
                              np.ones(5, dtype=np.bool_))  # fmt: skip
    P = 1e-6 * random_covariances(rng, 10, 3).reshape(3, 3, 2, 5)
    z = 1e-3 * rng.standard_normal((4, 5))
    rows = [row for row in range(4) if available[row]]
    readings = Readings(z, np.broadcast_to(available[:, None], (4, 5)))
    taken = corrected_by(Bank(np.zeros((3, 2, 5)), P), readings, noise)[1]
    floors = 0
    for f, i in np.ndindex(2, 5):
        std = np.sqrt(np.diag(fix[..., i]))
        ratio = np.sqrt(own[FIX, f, i] / np.array(reference)[FIX])
        scale = np.maximum(ratio, SMALLEST_STD / std)
        floors += int(np.sum(scale > ratio))
        R = full_noise(scale[:, None] * fix[..., i] * scale, own[2, f, i])
        measured = [row for row in FIX if available[row]]
        np.testing.assert_allclose(noise.measurement[measured, f, i], np.diag(R)[measured])
        assert np.all(noise.measurement[measured, f, i] >= SMALLEST_STD**2 * (1.0 - 1e-15))
        hidden = [row for row in range(4) if row not in measured]
        np.testing.assert_array_equal(noise.measurement[hidden, f, i], own[hidden, f, i])
        expected = dense(np.zeros(3), P[..., f, i], z[:, i], R, rows)
        got = taken.bank
        np.testing.assert_allclose(got.mean[:, f, i], expected.mean, rtol=0, atol=1e-14)
        np.testing.assert_allclose(
            got.covariance[..., f, i], expected.covariance, rtol=0, atol=1e-12 * np.max(P)
        )
        assert taken.nis[f, i] == pytest.approx(expected.nis, rel=1e-10)
        assert taken.determinant[f, i] == pytest.approx(expected.determinant, rel=1e-10)
    assert floors > 10


def test_a_scale_makes_no_report_better_than_any_sensor_is() -> None:
    own = np.full((4, 1), 1e-4)
    available = np.array([True, True, False, False])
    noise = noise_of_readings(
        Noise(np.ones((2, 1)), own), UNIT, np.diag([1e-6, 1e-2, 1.0]), available
    )
    np.testing.assert_allclose(noise.measurement[:, 0], [1e-8, 1e-6, 1e-4, 1e-4])


def test_without_a_report_the_filters_run_on_their_own_noise() -> None:
    noise = Noise(np.ones((2, 3)), np.ones((4, 3)))
    assert noise_of_readings(noise, UNIT, None, ALL_ROWS) is noise


def test_without_any_row_nothing_changes(random_covariances: Covariances) -> None:
    P = random_covariances(np.random.default_rng(15), 1, 3)[..., 0]
    bank = one_filter([1.0, 2.0, 3.0], P)
    _, taken = corrected(bank, np.full(4, np.nan), np.ones(4), NO_ROWS)
    assert all_bytes(taken.bank) == all_bytes(bank)
    np.testing.assert_array_equal(
        [taken.nis, taken.fix_nis, taken.determinant], [[0.0], [0.0], [1.0]]
    )


@BOTH_KINDS
def test_masked_row_leaves_every_bit_as_if_it_had_not_been_there(
    random_covariances: Covariances, reported: bool
) -> None:
    """For other robots of the batch it is."""
    rng = np.random.default_rng(25)
    bank, noise, readings, fix = random_case(rng, random_covariances, 3)
    told = fix if reported else None
    together = corrected_by(
        bank, readings, noise_of_readings(noise, UNIT, told, readings.available)
    )
    for i in range(len(ALL_MASKS)):
        only = Bank(bank.mean[..., i], bank.covariance[..., i])
        own = Noise(noise.process[..., i], noise.measurement[..., i])
        available = readings.available[:, i]
        own = noise_of_readings(own, UNIT, fix[..., i] if reported else None, available)
        alone = corrected_by(only, Readings(readings.values[:, i], available), own)
        for one, other in zip(parts(*together), parts(*alone), strict=True):
            assert all_bytes(one[..., i]) == all_bytes(other)


def test_fix_that_is_rejected_leaves_every_bit_though_it_was_measured(
    random_covariances: Covariances,
) -> None:
    """Its rows are coupled for all robots of the batch, and taken by half of them."""
    rng = np.random.default_rng(32)
    bank, noise, readings, fix = random_case(rng, random_covariances, 3)
    readings = readings._replace(available=np.ones_like(readings.available))
    noise = noise_of_readings(noise, UNIT, fix, readings.available)
    seen = innovate(bank, readings, noise.measurement)
    rows = readings.available.copy()
    rows[FIX, ::2] = False
    everything = correct(bank, seen, noise, readings.available)
    compass = correct(bank, seen, noise, rows & (np.arange(4) == Row.COMPASS_YAW)[:, None])
    taken = correct(bank, seen, noise, rows)
    for half, expected in ((slice(0, None, 2), compass), (slice(1, None, 2), everything)):
        for one, other in zip(parts(seen, taken), parts(seen, expected), strict=True):
            assert all_bytes(one[..., half]) == all_bytes(other[..., half])
    nothing = correct(bank, seen, noise, np.zeros_like(rows))
    assert all_bytes(nothing.bank) == all_bytes(bank)


@BOTH_MODELS
@BOTH_KINDS
def test_filters_of_a_bank_equal_banks_of_one_bit_for_bit(
    random_covariances: Covariances, model: MotionModel, reported: bool
) -> None:
    """And slices of all that readings said are those of the filters."""
    rng = np.random.default_rng(26)
    bank, noise, readings, fix = random_case(rng, random_covariances, 5)
    noise = noise._replace(process=rng.uniform(1e-3, 1.0, noise.process.shape))
    control = rng.uniform(-0.5, 0.5, (2, len(ALL_MASKS)))
    told = fix if reported else None
    predicted = predict(model, bank, control, noise.process)
    used = noise_of_readings(noise, UNIT, told, readings.available)
    seen = innovate(predicted, readings, used.measurement)
    taken = correct(predicted, seen, used, readings.available)
    for f in range(5):
        which = slice(f, f + 1)
        alone = predict(model, bank.filters(which), control, noise.process[:, which])
        assert all_bytes(alone) == all_bytes(predicted.filters(which))
        own = noise_of_readings(noise.filters(which), UNIT, told, readings.available)
        assert (own.coupling is not None) == reported
        assert own.measurement.tobytes() == used.filters(which).measurement.tobytes()
        said = innovate(alone, readings, own.measurement)
        assert all_bytes(said) == all_bytes(seen.filters(which))
        corrections = [
            correct(alone, said, own, readings.available),
            correct(predicted.filters(which), seen.filters(which), used.filters(which),
                    readings.available),
        ]  # fmt: skip
        for found in corrections:
            assert all_bytes(found.bank) == all_bytes(taken.bank.filters(which))
            for one, other in zip(found[1:], taken[1:], strict=True):
                assert all_bytes(one) == all_bytes(other[which])


@BOTH_KINDS
def test_filters_that_no_reading_is_compared_with_stay_as_they_are(
    random_covariances: Covariances, reported: bool
) -> None:
    """The last filters of a bank, of which there are no innovations; bit for bit."""
    rng = np.random.default_rng(27)
    bank, noise, readings, fix = random_case(rng, random_covariances, 5)
    first, rest = slice(0, 3), slice(3, 5)
    used = noise_of_readings(
        noise.filters(first), UNIT, fix if reported else None, readings.available
    )
    seen = innovate(bank.filters(first), readings, used.measurement)
    taken = correct(bank, seen, used, readings.available)
    expected = correct(bank.filters(first), seen, used, readings.available)
    assert all_bytes(taken.bank.filters(first)) == all_bytes(expected.bank)
    assert all_bytes(taken.bank.filters(rest)) == all_bytes(bank.filters(rest))
    for one, other in zip(taken[1:], expected[1:], strict=True):
        assert all_bytes(one) == all_bytes(other)


@BOTH_MODELS
def test_a_batch_predicts_what_its_robots_do_alone(
    random_covariances: Covariances, model: MotionModel
) -> None:
    """To rounding: numpy may take other instructions for the sine of one than of many."""
    rng = np.random.default_rng(18)
    mean, P = rng.standard_normal((3, 2, 2, 3)), random_covariances(rng, 12, 3)
    P = P.reshape(3, 3, 2, 2, 3)
    control, Q = rng.uniform(-0.5, 0.5, (2, 2, 3)), rng.uniform(0.1, 1.0, (2, 2, 2, 3))
    together = predict(model, Bank(mean, P), control, Q)
    for i in np.ndindex(2, 3):
        bank = Bank(mean[:, :, *i], P[:, :, :, *i])
        alone = predict(model, bank, control[:, *i], Q[:, :, *i])
        np.testing.assert_allclose(together.mean[..., *i], alone.mean, rtol=1e-15, atol=1e-15)
        np.testing.assert_allclose(
            together.covariance[..., *i], alone.covariance, rtol=1e-13, atol=1e-14
        )


@BOTH_MODELS
def test_prediction_is_A_P_A_plus_W_Q_W(
    random_covariances: Covariances, model: MotionModel
) -> None:
    rng = np.random.default_rng(27)
    mean, P = rng.standard_normal((3, 50)), random_covariances(rng, 50, 3)
    control, Q = rng.uniform(-1.0, 1.0, (2, 50)), rng.uniform(0.0, 1.0, (2, 50))
    motion = move(model, mean, control)
    got = predict_covariance(P, motion, Q)
    A, W = (components_last(m, 2) for m in (motion.motion_jacobian(), motion.noise_jacobian()))
    noise = components_last(diagonal_matrix(Q), 2)
    expected = A @ components_last(P, 2) @ np.swapaxes(A, 1, 2) + W @ noise @ np.swapaxes(W, 1, 2)
    np.testing.assert_allclose(components_last(got, 2), expected, rtol=1e-13, atol=1e-14)
    assert_symmetric(got)


def cut_in(pieces: int, way: float, turn: float) -> Bank:
    """Take a robot that is known exactly over one step, cut in so many equal pieces."""
    bank = one_filter([0.0, 0.0, 0.0], np.zeros((3, 3)))
    Q = np.array([[0.0], [math.radians(3.0) ** 2 / pieces]])
    for _ in range(pieces):
        bank = predict(MotionModel.EXACT_ARC, bank, np.array([way, turn]) / pieces, Q)
    return bank


@pytest.mark.parametrize("turn", [0.0, 0.3, -1.2])
def test_a_step_cut_in_two_ends_where_it_did_with_a_little_more_doubt(turn: float) -> None:
    """0.3 m/s for 375 ms, heading noise of 3 degrees: way/2 and sqrt(5/16) way of it sideways."""
    way = 0.3 * 0.375
    whole, halves, many = (cut_in(pieces, way, turn) for pieces in (1, 2, 64))
    for cut in (halves, many):
        np.testing.assert_allclose(cut.mean, whole.mean, rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(cut.covariance[2, 2], whole.covariance[2, 2], rtol=1e-14)
    if turn == 0.0:
        sideways = [math.sqrt(bank.covariance[1, 1, 0]) for bank in (whole, halves, many)]
        lever = way * math.radians(3.0)
        np.testing.assert_allclose(sideways[:2], [0.5 * lever, math.sqrt(0.3125) * lever])
        np.testing.assert_allclose(sideways, [2.9e-3, 3.3e-3, 3.4e-3], rtol=0.0, atol=0.05e-3)


@pytest.mark.parametrize("order", list(itertools.permutations(range(4)))[::3], ids=str)
def test_order_of_the_rows_does_not_matter(
    order: tuple[int, ...], random_covariances: Covariances
) -> None:
    """One reading after the other, each against the filter that the one before it left."""
    rng = np.random.default_rng(28)
    bank, noise, _, _ = random_case(rng, random_covariances, 2)
    z = 0.3 * rng.standard_normal((4, len(ALL_MASKS)))
    everything = np.ones(z.shape, dtype=np.bool_)
    together = corrected_by(bank, Readings(z, everything), noise)[1]
    nis, determinant = np.zeros_like(together.nis), np.ones_like(together.nis)
    for row in order:
        available = everything & (np.arange(4) == row)[:, None]
        taken = corrected_by(bank, Readings(z, available), noise)[1]
        bank, nis, determinant = taken.bank, nis + taken.nis, determinant * taken.determinant
    np.testing.assert_allclose(bank.mean, together.bank.mean, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(bank.covariance, together.bank.covariance, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(nis, together.nis, rtol=1e-11)
    np.testing.assert_allclose(determinant, together.determinant, rtol=1e-12)


def test_correlation_inside_the_measurement_noise_counts() -> None:
    """By hand: P = I, R on x and y = [[1, .5], [.5, 1]], innovation (1, 0)."""
    fix = np.eye(3)
    fix[0, 1] = fix[1, 0] = 0.5
    rows = np.array([True, True, False, False])
    noise = noise_of_readings(Noise(np.ones((2, 1)), np.ones((4, 1))), UNIT, fix, rows)
    readings = Readings(np.array([1.0, 0.0, 0.0, 0.0]), rows)
    _, taken = corrected_by(one_filter(np.zeros(3), np.eye(3)), readings, noise)
    # S = [[2, .5], [.5, 2]], S^-1 = [[2, -.5], [-.5, 2]] / 3.75
    np.testing.assert_allclose(taken.bank.mean[:, 0], [2.0 / 3.75, -0.5 / 3.75, 0.0], atol=1e-15)
    assert taken.nis[0] == pytest.approx(2.0 / 3.75, abs=1e-15)
    assert taken.determinant[0] == pytest.approx(3.75, abs=1e-14)


@pytest.mark.parametrize("row", [2, 3])
@pytest.mark.parametrize(
    ("heading", "measured", "innovation"),
    [
        (math.pi - 0.01, -math.pi + 0.01, 0.02),
        (-math.pi + 0.01, math.pi - 0.01, -0.02),
        (3.0, 3.0 + 6.0 * math.pi, 0.0),
        (-3.0, 3.1, 6.1 - 2.0 * math.pi),
        (3.0 + 4.0 * math.pi, 3.1, 0.1),
    ],
)
def test_yaw_innovation_goes_the_short_way_round(
    row: int, heading: float, measured: float, innovation: float
) -> None:
    z = np.zeros(4)
    z[row] = measured
    available = np.arange(4) == row
    seen, taken = corrected(one_filter([0.0, 0.0, heading], np.eye(3)), z, np.ones(4), available)
    assert seen.innovation[row, 0] == pytest.approx(innovation, abs=1e-14)
    mean = taken.bank.mean[:, 0]
    apart = math.remainder(mean[2] - heading - 0.5 * innovation, 2.0 * math.pi)
    assert abs(apart) < 1e-14
    assert -math.pi < mean[2] <= math.pi


def test_heading_that_is_corrected_over_pi_comes_out_wrapped() -> None:
    z = np.array([0.0, 0.0, -math.pi + 0.03, 0.0])
    available = np.array([False, False, True, False])
    bank = one_filter([0.0, 0.0, math.pi - 0.01], np.eye(3))
    _, taken = corrected(bank, z, np.ones(4), available)
    assert taken.bank.mean[2, 0] == pytest.approx(-math.pi + 0.01, abs=1e-14)


def test_positions_are_not_wrapped() -> None:
    z = np.array([100.0, -200.0, 0.0, 0.0])
    available = np.array([True, True, False, False])
    seen, taken = corrected(one_filter(np.zeros(3), np.eye(3)), z, np.ones(4), available)
    np.testing.assert_array_equal(seen.innovation[:, 0], [100.0, -200.0, 0.0, 0.0])
    np.testing.assert_allclose(taken.bank.mean[:, 0], [50.0, -100.0, 0.0], rtol=1e-15)


@BOTH_KINDS
def test_nis_of_right_noise_averages_to_the_number_of_rows(reported: bool) -> None:
    """Innovations drawn from S itself: the mean of chi-square is its degrees of freedom."""
    rng = np.random.default_rng(17)
    P = np.array([[0.3, 0.1, 0.02], [0.1, 0.2, 0.01], [0.02, 0.01, 0.05]])
    fix = np.diag([0.1, 0.2, 0.04])
    if reported:
        fix = np.array([[0.1, 0.08, -0.03], [0.08, 0.2, 0.02], [-0.03, 0.02, 0.04]])
    S = H @ P @ H.T + full_noise(fix, 0.03)
    count = 20_000
    z = rng.multivariate_normal(np.zeros(4), S, count).T
    own = np.broadcast_to(np.array([0.1, 0.2, 0.03, 0.04])[:, None, None], (4, 1, count))
    noise = Noise(np.ones((2, 1, count)), own)
    available = np.ones((4, count), dtype=np.bool_)
    noise = noise_of_readings(
        noise, (0.1, 0.2, 0.03, 0.04), fix[:, :, None] if reported else None, available
    )
    bank = Bank(np.zeros((3, 1, count)), np.broadcast_to(P[:, :, None, None], (3, 3, 1, count)))
    _, taken = corrected_by(bank, Readings(z, available), noise)
    # Variance of chi-square with n degrees of freedom is 2 n.
    assert np.mean(taken.nis) == pytest.approx(4.0, abs=6.0 * math.sqrt(8.0 / count))
    assert np.mean(taken.fix_nis) == pytest.approx(3.0, abs=6.0 * math.sqrt(6.0 / count))


def test_arguments_are_not_changed(random_covariances: Covariances) -> None:
    rng = np.random.default_rng(19)
    bank, noise, readings, fix = random_case(rng, random_covariances, 2)
    for array in (*bank, *noise[:2], *readings, fix):
        array.flags.writeable = False
    predict(MotionModel.EXACT_ARC, bank, np.array([0.1, 0.2]), noise.process)
    used = noise_of_readings(noise, UNIT, fix, readings.available)
    assert used.coupling is not None
    seen = innovate(bank, readings, used.measurement)
    for array in (*used[:2], *used.coupling, *seen):
        array.flags.writeable = False
    correct(bank, seen, used, readings.available)
    correct(bank, seen, noise, readings.available)


def test_errors_of_many_runs_are_as_large_as_the_covariance_says() -> None:
    """Sampled runs with the assumed noise: sum of NEES inside its chi-square band."""
    rng = np.random.default_rng(20)
    runs, checked_at = 500, (20, 40, 60)
    P0 = np.diag([0.05, 0.05, 0.02]) ** 2
    Q = np.array([0.01, 0.005]) ** 2
    own = np.array([0.03, 0.03, 0.02, 0.03]) ** 2
    fix = np.diag(own[FIX])
    fix[0, 1] = fix[1, 0] = 0.5 * fix[0, 0]
    R = full_noise(fix, own[2])
    noise = Noise(
        np.broadcast_to(Q[:, None, None], (2, 1, runs)),
        np.broadcast_to(own[:, None, None], (4, 1, runs)),
    )
    mean = np.broadcast_to(np.array([0.0, 0.0, 3.0])[:, None], (3, runs))
    truth = mean + rng.multivariate_normal(np.zeros(3), P0, runs).T
    bank = Bank(mean[:, None], np.broadcast_to(P0[:, :, None, None], (3, 3, 1, runs)))
    for i in range(1, max(checked_at) + 1):
        control = np.array([[0.15], [0.1 * math.sin(0.2 * i)]]) * np.ones(runs)
        driven = control + rng.standard_normal((2, runs)) * np.sqrt(Q)[:, None]
        truth = move(MotionModel.EXACT_ARC, truth, driven).mean
        z = truth[STATE_OF_ROW] + rng.multivariate_normal(np.zeros(4), R, runs).T
        available = rng.random((4, runs)) < 0.6
        used = noise_of_readings(noise, tuple(own), fix[:, :, None], available)
        bank = predict(MotionModel.EXACT_ARC, bank, control, noise.process)
        bank = corrected_by(bank, Readings(z, available), used)[1].bank
        if i in checked_at:
            error = bank.mean[:, 0] - truth
            error[2] = np.arctan2(np.sin(error[2]), np.cos(error[2]))
            P = components_last(bank.covariance[:, :, 0], 2)
            nees = np.sum(error.T * np.linalg.solve(P, error.T[..., None])[..., 0], axis=-1)
            assert CHI_SQUARE_1500[0] < np.sum(nees) < CHI_SQUARE_1500[1]


@BOTH_KINDS
def test_covariances_are_exactly_symmetric(random_covariances: Covariances, reported: bool) -> None:
    """Bit for bit, without a mean of the two halves at the end."""
    rng = np.random.default_rng(29)
    bank, noise, readings, fix = random_case(rng, random_covariances, 8)
    for _ in range(5):
        scale = 10.0 ** rng.uniform(-6.0, 3.0, noise.measurement.shape)
        varied = noise._replace(measurement=scale)
        if reported:
            varied = noise_of_readings(varied, UNIT, fix, readings.available)
        control = rng.uniform(-2.0, 2.0, (2, len(ALL_MASKS)))
        predicted = predict(MotionModel.EXACT_ARC, bank, control, noise.process)
        assert_symmetric(predicted.covariance)
        bank = corrected_by(predicted, readings, varied)[1].bank
        assert_symmetric(bank.covariance)


def test_covariance_survives_a_measurement_far_better_than_what_was_known() -> None:
    """Where P- - K H P- loses all its digits: P of 1e8 m^2 meets R of 1e-8 m^2."""
    root = np.array([[1e4, 0.0, 0.0], [7e3, 4e3, 0.0], [0.3, -0.2, 0.1]])
    for mask in ALL_MASKS[1:]:
        bank = one_filter(np.zeros(3), root @ root.T)
        P = corrected(bank, np.zeros(4), np.full(4, 1e-8), np.array(mask))[1].bank.covariance
        assert_symmetric(P)
        assert_positive_definite(P)
        measured = np.array([mask[0], mask[1], mask[2] or mask[3]])
        assert np.all(np.diag(P[..., 0])[measured] < 1.01e-8)
        assert np.all(np.diag(P[..., 0])[measured] > 0.49e-8)


@pytest.mark.parametrize("correlation", [0.5, 0.99, 0.9999, -0.99999, 0.999998])
@pytest.mark.parametrize("std", [SMALLEST_STD, 1e-2])
def test_lost_pose_takes_over_the_correlation_of_a_fix(correlation: float, std: float) -> None:
    """However nearly singular a report may be: its smallest eigenvalue is 1 - |correlation|."""
    P = np.array([[1e6, 3e5, 50.0], [3e5, 1e6, -40.0], [50.0, -40.0, 1.0]])
    fix = std**2 * np.array([[1.0, correlation, 0.0], [correlation, 1.0, 0.0], [0.0, 0.0, 1.0]])
    rows = np.array([True, True, False, False])
    noise = noise_of_readings(Noise(np.ones((2, 1)), np.ones((4, 1))), UNIT, fix, rows)
    taken = corrected_by(one_filter(np.zeros(3), P), Readings(np.zeros(4), rows), noise)[1]
    found = taken.bank.covariance[..., 0]
    np.testing.assert_allclose(found[:2, :2], fix[:2, :2], rtol=1e-9)
    sizes = np.sqrt(np.diag(found))
    smallest = np.linalg.eigvalsh(found / np.outer(sizes, sizes))[0]
    assert smallest == pytest.approx(1.0 - abs(correlation), rel=1e-3)


@BOTH_KINDS
def test_poses_that_are_almost_lost_are_found_by_the_best_sensor(reported: bool) -> None:
    """P as large as it may be, nearly singular or not; R as small as any; and again and again."""
    rng = np.random.default_rng(30)
    count = 1000
    std = np.array(LARGEST_POSE_STD) * 10.0 ** rng.uniform(-1.0, 2.0, (count, 3))
    P = limit_uncertainty(nearly_singular(rng, std))[:, :, None]
    R = SMALLEST_STD**2 * 10.0 ** np.maximum(rng.uniform(-6.0, 6.0, (4, 1, count)), 0.0)
    own, bank = Noise(np.zeros((2, 1, count)), R), Bank(np.zeros((3, 1, count)), P)
    for _ in range(10):
        available = rng.random((4, count)) < 0.5
        noise = own
        if reported:
            fix = (1.0 - 1e-6) * nearly_singular(rng, np.ones((count, 3)))
            fix += 1e-6 * np.eye(3)[:, :, None]
            noise = noise_of_readings(own, UNIT, fix, available)
        bank = corrected_by(bank, Readings(np.zeros((4, count)), available), noise)[1].bank
        assert_symmetric(bank.covariance)
        assert_positive_definite(bank.covariance)
        variance = np.einsum("ii...->i...", bank.covariance)[STATE_OF_ROW]
        assert np.all(np.where(available[:, None], variance / R, 0.0) <= 1.0 + 1e-9)


def nearly_singular(rng: np.random.Generator, std: FloatArray) -> FloatArray:
    """Return covariances `(3, 3, count)` of standard deviations `(count, 3)`."""
    count = len(std)
    root = rng.standard_normal((count, 3, 3)) * 10.0 ** rng.uniform(-8.0, 4.0, (count, 1, 3))
    C = root @ np.swapaxes(root, 1, 2)
    scale = std / np.sqrt(np.diagonal(C, axis1=1, axis2=2))
    P = np.moveaxis(C * scale[:, :, None] * scale[:, None], 0, -1)
    return 0.5 * (P + np.swapaxes(P, 0, 1))


def test_covariance_stays_positive_definite_over_a_million_rows() -> None:
    """R from 1e-6 to 1e6 of P, Q likewise, in 250 chains of 1000 instants with four rows each.

    Before each the units are changed, by powers of two, so that P stays at 1.
    """
    rng = np.random.default_rng(31)
    chains, steps = 250, 1000
    mean = np.zeros((3, 10, chains // 10))
    P: FloatArray = np.eye(3)[:, :, None, None] * np.ones((1, *mean.shape[1:]))
    readings = Readings(np.zeros((4, chains // 10)), np.ones((4, chains // 10), dtype=np.bool_))
    for k in range(steps):
        unit = np.exp2(-np.round(0.5 * np.log2(np.einsum("ii...->i...", P))))
        P = P * (unit[:, None] * unit[None])
        Q = 10.0 ** rng.uniform(-6.0, 6.0, (2, *mean.shape[1:]))
        Q[1] = np.minimum(Q[1], 10.0)
        bank = predict(
            MotionModel.EXACT_ARC, Bank(mean, P), rng.uniform(-0.5, 0.5, (2, chains // 10)), Q
        )
        variance = np.einsum("ii...->i...", bank.covariance)[STATE_OF_ROW]
        noise = Noise(Q, variance * 10.0 ** rng.uniform(-6.0, 6.0, variance.shape))
        P = corrected_by(bank, readings, noise)[1].bank.covariance
        if k % 20 == 0 or k > steps - 20:
            assert_symmetric(P)
            assert_positive_definite(P)


def test_covariance_stays_positive_definite_over_a_million_steps() -> None:
    """Side by side: ordinary, tiny, huge and lopsided noise; always, rarely, never measured."""
    rng = np.random.default_rng(21)
    steps, robots = 1000, 150
    Q = np.array([[4e-4, 3e-4], [1e-14, 1e-14], [1e2, 1e1], [1e-12, 1e1], [4e-4, 3e-4],
                  [1e-10, 1e-10], [4e-4, 3e-4]]).T  # fmt: skip
    R = np.ones((4, 1)) * [0.01, 1e-10, 1e6, 1e-8, 0.01, 1e8, 1e-6]
    R[2, -1] = 1e4
    filters = Q.shape[1]
    noise = Noise(
        np.broadcast_to(Q[:, :, None], (2, filters, robots)),
        np.broadcast_to(R[:, :, None], (4, filters, robots)),
    )
    share = np.repeat([1.0, 0.5, 0.3, 0.05, 0.002, 0.0], robots // 6)
    bank = Bank(
        np.zeros((3, filters, robots)),
        0.01 * np.eye(3)[:, :, None, None] * np.ones((filters, robots)),
    )
    for k in range(steps):
        control = rng.uniform([[-0.1], [-0.3]], [[0.3], [0.3]], (2, robots))
        bank = predict(MotionModel.EXACT_ARC, bank, control, noise.process)
        available = rng.random((4, robots)) < share
        readings = Readings(bank.mean[STATE_OF_ROW, 0], available)
        bank = corrected_by(bank, readings, noise)[1].bank
        if k % 50 == 49:
            assert np.all(np.isfinite(bank.mean))
            assert_symmetric(bank.covariance)
            assert_positive_definite(bank.covariance)
