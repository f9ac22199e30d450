# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Readings against the members: the NIS of the mixture, from explicit matrices."""

import numpy as np
import pytest
from banks import Covariances
from lasting_banks import Seen, matrices_of, random_seen

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.lasting.augmented import Component
from fnn_ekf_ros.core.lasting.comparison import Comparison, compare, two_row_nis
from fnn_ekf_ros.core.lasting.members import CHALLENGER, FILTER_COUNT, MEMBER_COUNT, WITNESS
from fnn_ekf_ros.core.rows import COMPASS, LRF_POSE

ROBOTS = 3
POSITION, FULL_FIX = [Row.X, Row.Y], [Row.X, Row.Y, Row.LRF_YAW]
COUPLED = pytest.mark.parametrize("coupled", [False, True], ids=["own noise", "reported noise"])
FIX_YAW = pytest.mark.parametrize("fix_yaw", [1.0, 0.0], ids=["no compass", "beside a compass"])
BELIEVED = pytest.mark.parametrize("believed", [False, True], ids=["no offset", "offset"])


def compared(seen: Seen) -> Comparison:
    return compare(seen.bank, seen.weights, seen.correcting, seen.readings, seen.noise)


def rows_available(rows: list[Row]) -> np.ndarray:
    available = np.zeros((4, ROBOTS), dtype=np.bool_)
    available[rows] = True
    return available


def mixture(seen: Seen, n: int, rows: list[Row]) -> tuple[FloatArray, FloatArray]:
    """Return r and S of robot n."""
    parts = [matrices_of(seen, k, n, rows) for k in range(MEMBER_COUNT)]
    w = seen.weights[:, n]
    r = sum(w[k] * part.r for k, part in enumerate(parts))
    S = np.zeros((len(rows), len(rows)))
    for k, part in enumerate(parts):
        d = part.r - r
        P = seen.bank.covariance[:, :, k, n]
        S += w[k] * (part.H @ P @ part.H.T + part.R + np.outer(d, d))
    return np.asarray(r), S


@COUPLED
@FIX_YAW
@BELIEVED
@pytest.mark.parametrize("rows", [POSITION, FULL_FIX], ids=["2 rows", "3 rows"])
def test_nis_of_fix_is_that_of_the_mixture(
    rows: list[Row], believed: bool, fix_yaw: float, coupled: bool, random_covariances: Covariances
) -> None:
    rng = np.random.default_rng(20)
    seen = random_seen(
        rng, random_covariances, rows_available(rows),
        coupled=coupled, fix_yaw=fix_yaw, believed=believed,
    )  # fmt: skip
    found = compared(seen)
    for n in range(ROBOTS):
        r, S = mixture(seen, n, rows)
        assert found.nis[LRF_POSE, n] == pytest.approx(r @ np.linalg.inv(S) @ r)
        np.testing.assert_allclose(found.mixed[rows, n], r)
        np.testing.assert_allclose(found.variance[rows, n], np.diag(S))
    assert not found.nis[COMPASS].any()
    assert not found.mixed[Row.COMPASS_YAW].any()


@BELIEVED
def test_nis_of_compass_is_the_smaller_of_mixture_and_witness(
    believed: bool, random_covariances: Covariances
) -> None:
    rng = np.random.default_rng(21)
    rows = [Row.COMPASS_YAW]
    seen = random_seen(
        rng, random_covariances, rows_available(rows), fix_yaw=0.0, believed=believed
    )
    seen.bank.mean[...] *= 0.1
    seen.bank.mean[2, WITNESS] += 2.0
    seen.readings.values[Row.COMPASS_YAW] = [seen.correcting.offset[0], 2.0, 2.2]
    found = compared(seen)
    smaller = set()
    for n in range(ROBOTS):
        r, S = mixture(seen, n, rows)
        own = matrices_of(seen, WITNESS, n, rows)
        P = seen.bank.covariance[:, :, WITNESS, n]
        by_witness = (own.r**2 / (own.H @ P @ own.H.T + own.R)).item()
        by_mixture = (r**2 / S).item()
        nis = found.witness_innovation[0] ** 2 / found.witness_variance[0]
        assert nis[n] == pytest.approx(by_witness)
        assert found.nis[COMPASS, n] == pytest.approx(min(by_mixture, by_witness))
        smaller.add(by_witness < by_mixture)
        np.testing.assert_allclose(found.mixed[rows, n], r)
        np.testing.assert_allclose(found.variance[rows, n], S[0])
    assert smaller == {False, True}
    assert not found.nis[LRF_POSE].any()


@COUPLED
def test_each_filter_is_compared(coupled: bool, random_covariances: Covariances) -> None:
    """Innovations, noise of the compass, and NIS and det S of x and y, copies included."""
    rng = np.random.default_rng(22)
    rows = list(Row)
    seen = random_seen(
        rng, random_covariances, rows_available(rows), coupled=coupled, fix_yaw=0.0, believed=True
    )
    found = compared(seen)
    for k in range(FILTER_COUNT):
        for n in range(ROBOTS):
            every, fix = matrices_of(seen, k, n, rows), matrices_of(seen, k, n, POSITION)
            P = seen.bank.covariance[:, :, k, n]
            S = fix.H @ P @ fix.H.T + fix.R
            np.testing.assert_allclose(found.innovation[:, k, n], every.r, atol=1e-14)
            assert found.compass_noise[k, n] == pytest.approx(every.R[2, 2])
            assert found.position_nis[k, n] == pytest.approx(fix.r @ np.linalg.inv(S) @ fix.r)
            assert found.position_determinant[k, n] == pytest.approx(np.linalg.det(S))


def test_believed_offset_is_subtracted_for_all_but_the_witness(
    random_covariances: Covariances,
) -> None:
    """And from a fix's yaw only where no compass has been read."""
    rng = np.random.default_rng(23)
    seen = random_seen(
        rng, random_covariances, rows_available(list(Row)),
        fix_yaw=np.array([1.0, 0.0, 1.0]), believed=True,
    )  # fmt: skip
    without = seen.correcting._replace(offset=np.zeros(ROBOTS), variance=np.zeros(ROBOTS))
    r, plain = compared(seen).innovation, compared(seen._replace(correcting=without)).innovation
    shift = np.angle(np.exp(1j * (plain - r)))
    offset = seen.correcting.offset
    others = [k for k in range(FILTER_COUNT) if k not in (WITNESS, CHALLENGER)]
    np.testing.assert_allclose(
        shift[Row.COMPASS_YAW, others], np.broadcast_to(offset, (len(others), ROBOTS))
    )
    np.testing.assert_allclose(
        shift[Row.LRF_YAW, others],
        np.broadcast_to(offset * [1.0, 0.0, 1.0], (len(others), ROBOTS)),
        atol=1e-15,
    )
    assert not shift[:2].any()
    np.testing.assert_allclose(shift[:, WITNESS], 0.0, atol=1e-15)


def test_robots_of_a_batch_have_rows_of_their_own(random_covariances: Covariances) -> None:
    """With and without a compass, coupled, with and without each row: batch equals single."""
    rng = np.random.default_rng(24)
    available = np.array([[1, 1, 0, 1], [1, 1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 1], [0, 0, 0, 1]])
    available = available.T.astype(np.bool_)
    part = np.array([1.0, 1.0, 0.0, 0.0, 0.0])
    seen = random_seen(rng, random_covariances, available, coupled=True, fix_yaw=part)
    found = compared(seen)
    for n in range(available.shape[1]):
        coupling = seen.noise.coupling
        assert coupling is not None
        alone = compare(
            type(seen.bank)(*(array[..., n] for array in seen.bank)),
            seen.weights[..., n],
            type(seen.correcting)(*(array[..., n] for array in seen.correcting)),
            type(seen.readings)(*(array[..., n] for array in seen.readings)),
            seen.noise._replace(
                process=seen.noise.process[..., n], measurement=seen.noise.measurement[..., n],
                coupling=type(coupling)(*(array[..., n] for array in coupling)),
            ),
        )  # fmt: skip
        for name, one in alone._asdict().items():
            if name == "correcting":
                continue
            np.testing.assert_allclose(
                one, getattr(found, name)[..., n], rtol=1e-12, atol=1e-14, err_msg=name
            )
    assert np.array_equal(found.nis[COMPASS] > 0.0, available[Row.COMPASS_YAW])
    assert np.array_equal(found.nis[LRF_POSE] > 0.0, available[[0, 3]].any(axis=0))


@pytest.mark.parametrize("row", [Row.COMPASS_YAW, Row.LRF_YAW])
def test_yaw_off_by_about_pi_fits_no_mixture(row: Row, random_covariances: Covariances) -> None:
    """To the left for some members and to the right for others: turned by pi it is as unlikely."""
    rng = np.random.default_rng(24)
    rows = [row] if row is Row.COMPASS_YAW else FULL_FIX
    seen = random_seen(
        rng, random_covariances, rows_available(rows), coupled=False, fix_yaw=0.0, believed=False
    )
    yaw = seen.bank.mean[Component.YAW]
    yaw[:] = 0.01 * rng.standard_normal(yaw.shape)
    seen.bank.mean[[Component.YAW_DRIFT, Component.YAW_OFFSET]] = 0.0
    seen.bank.covariance[...] *= 0.01
    z = seen.readings.values
    z[[Row.COMPASS_YAW, Row.LRF_YAW]] = 3.0
    near = compared(seen).nis
    z[[Row.COMPASS_YAW, Row.LRF_YAW]] = np.pi
    sensor = COMPASS if row is Row.COMPASS_YAW else LRF_POSE
    opposite = compared(seen)
    assert np.ptp(np.sign(opposite.innovation[row, :MEMBER_COUNT]), axis=0).max() == 2.0
    assert np.all(opposite.nis[sensor] > 0.9 * near[sensor])


def test_nis_of_two_rows() -> None:
    S = np.array([[0.3, 0.1], [0.1, 0.5]])
    r = np.array([0.7, -0.4])
    nis, determinant = two_row_nis(r, S)
    assert nis == pytest.approx(r @ np.linalg.inv(S) @ r)
    assert determinant == pytest.approx(np.linalg.det(S))
