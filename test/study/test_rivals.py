# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The rival filters against scalar references, and what all of them must do."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from drives import TRUE_Q, TRUE_R
from jacobians import motion_jacobian

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, transpose
from fnn_ekf_ros.core.motion import MotionModel, move
from fnn_ekf_ros.study import blocks
from fnn_ekf_ros.study.recording import Estimates, Recording, Start
from fnn_ekf_ros.study.rivals import innovation_based, multiple_model, sage_husa, variational_bayes
from fnn_ekf_ros.study.rivals.innovation_based import InnovationBasedSettings
from fnn_ekf_ros.study.rivals.multiple_model import MultipleModelSettings
from fnn_ekf_ros.study.rivals.sage_husa import SageHusaSettings
from fnn_ekf_ros.study.rivals.shared import matmul, wheel_noise
from fnn_ekf_ros.study.rivals.variational_bayes import VariationalBayesSettings

ARC = MotionModel.EXACT_ARC
X, Y, COMPASS, LRF_YAW = range(4)
NO_LRF_YAW = np.array([True, True, True, False])


class Rival(NamedTuple):
    run: Callable[..., Estimates]
    settings: Any


SMALL_BANK = MultipleModelSettings((0.2, 1.0, 5.0), (0.2, 1.0, 5.0))
ALONE = MultipleModelSettings((1.0,), (1.0,))
RIVALS = {
    "iae": Rival(innovation_based.run, InnovationBasedSettings()),
    "sage-husa": Rival(sage_husa.run, SageHusaSettings()),
    "vb": Rival(variational_bayes.run, VariationalBayesSettings()),
    "bank": Rival(multiple_model.run, SMALL_BANK),
}
every_rival = pytest.mark.parametrize("rival", RIVALS.values(), ids=RIVALS)


def only(*names: str) -> Any:
    return pytest.mark.parametrize("rival", [RIVALS[name] for name in names], ids=names)


def drive(
    steps: int, runs: int, seed: int, available: BoolArray = NO_LRF_YAW
) -> tuple[Recording, Start]:
    """Return robots in gentle turns on exact arcs and a right start; masked rows hold nan."""
    rng = np.random.default_rng(seed)
    phase = np.arange(steps)[:, None] / 150.0 + rng.random(runs)
    u = np.stack([np.full(phase.shape, 0.1125), 0.08 * np.sin(2.0 * np.pi * phase)], axis=-1)
    truth = np.zeros((steps + 1, runs, 3))
    for k in range(steps):
        truth[k + 1] = move(ARC, truth[k].T, u[k].T).mean.T
    control = u + rng.normal(size=u.shape) * np.sqrt(TRUE_Q)
    z = truth[1:][..., [0, 1, 2, 2]]
    z = z + rng.normal(size=z.shape) * np.sqrt(TRUE_R)
    available = np.broadcast_to(available, z.shape)
    recording = Recording(
        0.375, truth, control, np.where(available, z, np.nan), available,
        np.tile(TRUE_Q, (steps, 1)), np.tile(TRUE_R, (steps, 1)),
    )  # fmt: skip
    mean = truth[0] + rng.normal(size=(runs, 3)) * np.sqrt(TRUE_R[:3])
    return recording, Start(mean, np.diag(TRUE_R[:3]), TRUE_Q, TRUE_R)


def stand(
    steps: int, runs: int, seed: int, q: float, rows: tuple[int, ...] = (X,), gaps: float = 0.0
) -> tuple[Recording, Start]:
    """Return robots facing x whose wheels report nothing while x walks at random.

    The heading is all but known, so that the filter of x is a scalar linear one. In a share of
    the steps nothing is measured; z is nan there.
    """
    r, rng = TRUE_R[X], np.random.default_rng(seed)
    truth = np.zeros((steps + 1, runs, 3))
    truth[1:, :, 0] = np.cumsum(rng.normal(size=(steps, runs)), axis=0) * math.sqrt(q)
    available = np.zeros((steps, runs, 4), dtype=np.bool_)
    available[..., rows] = rng.random((steps, runs, 1)) >= gaps
    z = truth[1:][..., [0, 1, 2, 2]] + rng.normal(size=available.shape) * math.sqrt(r)
    z[~available] = np.nan
    Q, R = np.array([q, 1e-10]), np.full(4, r)
    recording = Recording(
        0.375, truth, np.zeros((steps, runs, 2)), z, available,
        np.tile(Q, (steps, 1)), np.tile(R, (steps, 1)),
    )  # fmt: skip
    return recording, Start(np.zeros((runs, 3)), np.diag([r, r, 1e-8]), Q, R)


def rmse(recording: Recording, track: Estimates) -> FloatArray:
    error = track.mean - recording.truth[1:]
    error[..., 2] = wrap_angle(error[..., 2])
    return np.sqrt(np.mean(error**2, axis=(0, 1)))


def last_process_noise(recording: Recording, track: Estimates) -> FloatArray:
    """Return Q as the last step, which had no measurement, reveals it."""
    assert not recording.available[-1].any()
    before, after = (np.moveaxis(P, 0, -1) for P in track.covariance[-2:])
    motion = move(ARC, track.mean[-2].T, recording.control[-1].T)
    A = motion_jacobian(motion)
    return wheel_noise(motion, after - matmul(matmul(A, before), transpose(A))).T


# --- scalar references -----------------------------------------------------------------------


def same_scalar(track: Estimates, reference: list[tuple[float, float]]) -> None:
    said = np.stack([track.mean[:, 0, 0], track.covariance[:, 0, 0, 0]], axis=-1)
    np.testing.assert_allclose(said, reference, rtol=1e-9, atol=1e-12)


def test_variational_bayes_is_at_the_fixed_point_of_the_paper() -> None:
    recording, start = stand(80, 1, 1, 1e-4, gaps=0.3)
    start = start._replace(measurement_noise=np.full(4, 0.2))
    settings = VariationalBayesSettings(forgetting=0.9, iterations=80, start_confidence=2.0)
    track = variational_bayes.run(ARC, recording, start, settings)
    m, P, alpha, beta = 0.0, 0.01, 2.0, 0.4
    for k, z in enumerate(recording.measurement[:, 0, X].tolist()):
        m_minus, P_minus = m, P + 1e-4
        if math.isnan(z):  # neither forgotten nor learned
            P = P_minus
            continue
        alpha, beta_minus = 0.9 * alpha + 0.5, 0.9 * beta
        m, P = track.mean[k, 0, 0], track.covariance[k, 0, 0, 0]
        # Both equations of the paper's update hold at once, for one and the same beta.
        beta = beta_minus + 0.5 * ((z - m) ** 2 + P)
        R = beta / alpha
        K = P_minus / (P_minus + R)
        np.testing.assert_allclose([m, P], [m_minus + K * (z - m_minus), K * R], rtol=1e-8)


def test_variational_bayes_of_a_known_state_averages_squares() -> None:
    recording, start = stand(40, 1, 2, 1e-14)
    start = start._replace(mean=np.zeros((1, 3)), covariance=np.diag([1e-14, 1e-14, 1e-14]))
    settings = VariationalBayesSettings(forgetting=1.0, iterations=1, start_confidence=3.0)
    track = variational_bayes.run(ARC, recording, start, settings)
    z2 = recording.measurement[:, 0, X] ** 2
    before = np.concatenate([[0.0], np.cumsum(z2)[:-1]])
    R = (3.0 * 0.01 + 0.5 * before) / (3.0 + 0.5 * np.arange(40))
    np.testing.assert_allclose(track.nis[:, 0], z2 / R, rtol=1e-6)


def test_innovation_based_equals_its_scalar_equations() -> None:
    recording, start = stand(80, 1, 3, 1e-3, (X, Y), gaps=0.3)
    start = start._replace(process_noise=np.array([1e-2, 1e-10]), measurement_noise=np.full(4, 0.1))
    settings = InnovationBasedSettings(window_length=12, first_use=4, smallest_share=0.3)
    x, P, Q, R = 0.0, 0.01, 1e-2, 0.1
    window: list[float] = []
    reference, floored = [], 0
    for z in recording.measurement[:, 0, X].tolist():
        P_minus = P + Q
        if math.isnan(z):
            P = P_minus
            reference.append((x, P))
            continue
        r = z - x
        K = P_minus / (P_minus + R)
        x, P = x + K * r, (1.0 - K) * P_minus
        reference.append((x, P))
        window = [*window, r * r][-12:]
        if len(window) >= 4:
            C = sum(window) / len(window)
            Q, R = K * C * K, max(C - P_minus, 0.3 * C)
            floored += C - P_minus < 0.3 * C
    assert 0 < floored < 50  # both branches
    same_scalar(innovation_based.run(ARC, recording, start, settings), reference)


def test_sage_husa_equals_its_scalar_equations() -> None:
    recording, start = stand(80, 1, 4, 1e-3, (X, Y), gaps=0.3)
    start = start._replace(process_noise=np.array([1e-2, 1e-10]), measurement_noise=np.full(4, 0.1))
    x, P, Q, R = 0.0, 0.01, 1e-2, 0.1
    reference, k = [], 0
    for z in recording.measurement[:, 0, X].tolist():
        P_minus = P + Q
        if math.isnan(z):
            P = P_minus
            reference.append((x, P))
            continue
        k += 1
        K = P_minus / (P_minus + R)
        step = K * (z - x)
        x, P = x + step, (1.0 - K) * P_minus
        reference.append((x, P))
        d = (1.0 - 0.9) / (1.0 - 0.9 ** (k + 1))
        Q, R = (1.0 - d) * Q + d * step**2, (1.0 - d) * R + d * ((z - x) ** 2 + P)
    settings = SageHusaSettings(fading=0.9)
    same_scalar(sage_husa.run(ARC, recording, start, settings), reference)


# --- a stationary problem --------------------------------------------------------------------


@pytest.mark.parametrize("wrong", [1.0 / 25.0, 25.0])
def test_variational_bayes_finds_the_true_r_where_q_is_right(wrong: float) -> None:
    q, r = 1e-3, 0.01
    recording, start = stand(900, 20, 5, q)
    start = start._replace(measurement_noise=np.full(4, wrong * r))
    track = variational_bayes.run(ARC, recording, start, VariationalBayesSettings())
    # With one row S = r^2 / nis, and of that P- is known.
    innovation = recording.measurement[1:, :, X] - track.mean[:-1, :, 0]
    R = innovation**2 / track.nis[1:] - track.covariance[:-1, :, 0, 0] - q
    assert np.mean(R[500:]) == pytest.approx(r, rel=0.1)


def test_wheel_noise_undoes_its_own_projection() -> None:
    rng = np.random.default_rng(7)
    motion = move(ARC, rng.normal(size=(3, 50)), rng.normal(size=(2, 50)))
    Q = rng.uniform(0.1, 2.0, size=(2, 50))
    W = motion.noise_jacobian()
    np.testing.assert_allclose(wheel_noise(motion, matmul(W * Q, transpose(W))), Q)


def test_wheel_noise_is_the_least_squares_solution() -> None:
    rng = np.random.default_rng(23)
    motion = move(ARC, rng.normal(size=(3, 1)), rng.normal(size=(2, 1)))
    root = rng.normal(size=(3, 3))
    back = np.linalg.pinv(motion.noise_jacobian()[..., 0])
    expected = np.diagonal(back @ root @ root.T @ back.T)
    M = (root @ root.T)[..., None]
    np.testing.assert_allclose(wheel_noise(motion, M)[:, 0], expected)


# --- what all of them must do ----------------------------------------------------------------


@every_rival
def test_masked_rows_are_as_if_they_were_not_there(rival: Rival) -> None:
    mask = np.random.default_rng(10).random((80, 2, 4)) < 0.5
    recording, start = drive(80, 2, 11, mask)
    garbage = recording._replace(measurement=np.where(mask, recording.measurement, 1e6))
    for one, other in zip(
        rival.run(ARC, recording, start, rival.settings),
        rival.run(ARC, garbage, start, rival.settings),
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)


@only("iae", "sage-husa", "vb")
@pytest.mark.parametrize("row", [X, COMPASS, LRF_YAW])
@pytest.mark.slow
def test_a_row_that_was_never_measured_keeps_its_r(rival: Rival, row: int) -> None:
    others = np.arange(4) != row
    # All rows but one for 120 steps, then a step without any, then the one alone.
    mask = np.concatenate([np.tile(others, (120, 1, 1)), np.zeros((1, 1, 4)), ~others[None, None]])
    recording, start = drive(122, 1, 12, mask > 0.0)
    start = start._replace(measurement_noise=3.0 * TRUE_R)
    track = rival.run(ARC, recording, start, rival.settings)
    before_last = (np.arange(122) < 121)[:, None, None]
    blind = recording._replace(available=recording.available & before_last)
    predicted = rival.run(ARC, blind, start, rival.settings)
    state = (0, 1, 2, 2)[row]
    innovation = wrap_angle(recording.measurement[-1, 0, row] - predicted.mean[-1, 0, state])
    S = innovation**2 / track.nis[-1, 0]
    R = S - predicted.covariance[-1, 0, state, state]
    np.testing.assert_allclose(R, 3.0 * TRUE_R[row], rtol=1e-6)


@only("iae", "sage-husa")
@pytest.mark.parametrize(
    ("rows", "taught"),
    [
        ((X, Y), (True, False)),
        ((COMPASS,), (False, True)),
        ((LRF_YAW,), (False, True)),
        ((X,), (False, False)),
        ((X, Y, COMPASS), (True, True)),
    ],
)
def test_wheel_noise_that_no_row_shows_keeps_its_q(
    rival: Rival, rows: tuple[int, ...], taught: tuple[bool, bool]
) -> None:
    mask = np.zeros((121, 1, 4), dtype=np.bool_)
    mask[:-1, :, list(rows)] = True
    recording, start = drive(121, 1, 13, mask)
    track = rival.run(ARC, recording, start._replace(process_noise=3.0 * TRUE_Q), rival.settings)
    kept = np.isclose(last_process_noise(recording, track)[0], 3.0 * TRUE_Q, rtol=1e-6)
    np.testing.assert_array_equal(kept, np.logical_not(taught))


def test_innovation_based_takes_the_gain_of_the_rows_that_were_measured() -> None:
    # x, y and yaw, then x and y alone, then nothing: the last step reveals Q.
    mask = np.zeros((3, 1, 4), dtype=np.bool_)
    mask[0, :, :LRF_YAW], mask[1, :, :COMPASS] = True, True
    recording, start = drive(3, 1, 21, mask)
    settings = InnovationBasedSettings(window_length=2, first_use=2)
    track = innovation_based.run(ARC, recording, start, settings)
    x0 = np.stack([start.mean[0], track.mean[0, 0]])
    motion = move(ARC, x0.T, recording.control[:2, 0].T)
    r = recording.measurement[:2, 0, :2] - motion.mean[:2].T
    H, R = np.eye(3)[:2], np.diag(TRUE_R[:2])
    P_minus = np.linalg.inv(np.linalg.inv(track.covariance[1, 0]) - H.T @ np.linalg.inv(R) @ H)
    K = P_minus @ H.T @ np.linalg.inv(H @ P_minus @ H.T + R)
    back = np.linalg.pinv(motion.noise_jacobian()[..., 1])
    forward = (back @ K @ (r.T @ r / 2.0) @ K.T @ back.T)[0, 0]
    revealed = last_process_noise(recording, track)[0, 0]
    np.testing.assert_allclose(revealed, forward, rtol=1e-7)


@every_rival
def test_a_batch_of_starts_equals_one_by_one(rival: Rival) -> None:
    mask = np.random.default_rng(14).random((60, 3, 4)) < 0.8
    recording, start = drive(60, 3, 15, mask)
    wrong = np.array([0.04, 25.0])[:, None, None]
    both = start._replace(process_noise=wrong * TRUE_Q, measurement_noise=TRUE_R / wrong)
    together = rival.run(ARC, recording, both, rival.settings)
    assert together.mean.shape == (60, 2, 3, 3)
    assert together.covariance.shape == (60, 2, 3, 3, 3)
    assert together.nis.shape == together.degrees_of_freedom.shape == (60, 2, 3)
    for i, scale in enumerate((0.04, 25.0)):
        for j in range(3):
            parts = ("truth", "control", "measurement", "available")
            cut = {name: getattr(recording, name)[:, j : j + 1] for name in parts}
            one = rival.run(
                ARC,
                recording._replace(**cut),
                Start(start.mean[j : j + 1], start.covariance, scale * TRUE_Q, TRUE_R / scale),
                rival.settings,
            )
            for part, whole in zip(one, together, strict=True):
                np.testing.assert_allclose(part[:, 0], whole[:, i, j], rtol=1e-9, atol=1e-12)


def test_robots_do_not_depend_on_the_block_they_are_in(monkeypatch: pytest.MonkeyPatch) -> None:
    recording, start = drive(30, 5, 24)
    wrong = np.array([0.04, 25.0])[:, None, None]
    both = start._replace(process_noise=wrong * TRUE_Q)  # one Q for all runs
    tracks = []
    for at_once in (1, 500, 150_000):
        monkeypatch.setattr(blocks, "NUMBERS_AT_ONCE", at_once)
        tracks.append(multiple_model.run(ARC, recording, both, SMALL_BANK))
    for one, few, all_of_them in zip(*tracks, strict=True):
        np.testing.assert_allclose(one, all_of_them, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(few, all_of_them, rtol=1e-9, atol=1e-12)


@every_rival
def test_covariances_stay_positive_definite_from_any_start(rival: Rival) -> None:
    mask = np.random.default_rng(16).random((300, 2, 4)) < 0.8
    recording, start = drive(300, 2, 17, mask)
    scales = np.array([0.04, 1.0, 25.0])
    q, k = (grid.reshape(-1, 1, 1) for grid in np.meshgrid(scales, scales))
    start = start._replace(process_noise=q * TRUE_Q, measurement_noise=k * TRUE_R)
    track = rival.run(ARC, recording, start, rival.settings)
    assert all(np.all(np.isfinite(part)) for part in track)
    np.testing.assert_array_equal(track.covariance, track.covariance.swapaxes(-1, -2))
    assert np.min(np.linalg.eigvalsh(track.covariance)) > 0.0


@every_rival
def test_process_noise_is_in_proportion_to_the_period(rival: Rival) -> None:
    recording, start = drive(60, 2, 18)
    slow = rival.run(ARC, recording._replace(period_s=0.75), start, rival.settings)
    doubled = start._replace(process_noise=2.0 * TRUE_Q)
    for one, other in zip(slow, rival.run(ARC, recording, doubled, rival.settings), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@every_rival
def test_the_motion_model_is_the_one_asked_for(rival: Rival) -> None:
    recording, start = drive(1, 2, 19, np.zeros(4, dtype=np.bool_))
    track = rival.run(MotionModel.PAPER, recording, start, rival.settings)
    moved = move(MotionModel.PAPER, start.mean.T, recording.control[0].T).mean.T
    np.testing.assert_allclose(track.mean[0], moved, atol=1e-12)


@every_rival
def test_a_lost_pose_is_as_uncertain_as_double_precision_can_hold(rival: Rival) -> None:
    recording, start = drive(2, 1, 22, np.zeros(4, dtype=np.bool_))
    start = start._replace(process_noise=np.full(2, 1e8))
    track = rival.run(ARC, recording, start, rival.settings)
    assert np.max(np.diagonal(track.covariance[-1, 0])) <= 1e6 * (1.0 + 1e-9)


@only("iae", "sage-husa", "vb", "bank")
@pytest.mark.slow
def test_a_far_too_large_r_is_mended(rival: Rival) -> None:
    recording, start = drive(500, 8, 20)
    start = start._replace(measurement_noise=25.0 * TRUE_R)
    fixed = rmse(recording, multiple_model.run(ARC, recording, start, ALONE))
    adapted = rmse(recording, rival.run(ARC, recording, start, rival.settings))
    assert np.all(adapted[:2] < 0.85 * fixed[:2])  # IAE leaves the heading's error


@pytest.mark.parametrize(
    ("settings", "name", "value"),
    [
        (InnovationBasedSettings, "first_use", 0),
        (InnovationBasedSettings, "first_use", 201),
        (InnovationBasedSettings, "smallest_share", 0.0),
        (InnovationBasedSettings, "smallest_share", 1.1),
        (SageHusaSettings, "fading", 0.0),
        (SageHusaSettings, "fading", 1.0),
        (VariationalBayesSettings, "forgetting", 0.0),
        (VariationalBayesSettings, "forgetting", 1.01),
        (VariationalBayesSettings, "iterations", 0),
        (VariationalBayesSettings, "start_confidence", 0.0),
    ],
)
def test_settings_that_make_no_filter_are_refused(settings: Any, name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        settings(**{name: value})
