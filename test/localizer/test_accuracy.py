# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Accuracy: every odom of simulated runs against truth, and what the filter says of itself."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from localizers import feed, make_localizer, simulated

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.timeline.events import Output

SEEDS = range(100, 120)
SECONDS = 36.0


class Errors(NamedTuple):
    """Errors `(n, 3)` of the estimates of a run, and their covariances `(n, 3, 3)`.

    NIS and degrees of freedom, `(m,)`, are those of the periods in which something was measured.
    """

    error: FloatArray
    covariance: FloatArray
    nis: FloatArray
    freedom: FloatArray

    def nees(self) -> FloatArray:
        """Return e' P^-1 e of each estimate."""
        solved = np.linalg.solve(self.covariance, self.error[..., None])[..., 0]
        return np.sum(self.error * solved, axis=-1)


def errors_of(outputs: list[Output], truth: dict[int, FloatArray]) -> Errors:
    """Return the errors of all estimates; truth is known at every period's end."""
    estimates = [output.estimate for output in outputs if output.estimate is not None]
    error = np.array([e.state.mean - truth[e.stamp_ns] for e in estimates])
    error[:, 2] = wrap_angle(error[:, 2])
    results = [e.result for e in estimates if e.result is not None]
    return Errors(
        error,
        np.array([e.state.covariance for e in estimates]),
        np.array([float(result.nis) for result in results]),
        np.array([float(result.degrees_of_freedom) for result in results]),
    )


@pytest.fixture(scope="module")
def errors() -> Callable[..., Errors]:
    """Errors of a filter on one of the simulated runs."""

    @functools.cache
    def run(seed: int, seconds: float = SECONDS, path: str = "sim2", **changes: Any) -> Errors:
        sent = simulated(seed, seconds, path=path)
        localizer = make_localizer(**{"adaptation": "none", **changes})
        return errors_of(feed(localizer, sent.arrivals), sent.truth)

    return run


@pytest.mark.parametrize("path", ["square", "round", "figure_eight", "sim1", "sim2"])
@pytest.mark.parametrize("adaptation", ["none", "r"])
@pytest.mark.slow
def test_every_odom_of_a_run_is_near_the_truth(
    errors: Callable[..., Errors], path: str, adaptation: str
) -> None:
    found = errors(7, 40.0, path, adaptation=adaptation)
    assert len(found.error) >= 104
    assert np.all(np.isfinite(found.error))
    position = np.linalg.norm(found.error[:, :2], axis=-1)
    # Right noise and no outliers: a fix alone is good to 0.1 m, the compass to sqrt(0.018) rad.
    assert np.max(position) < 0.35
    assert np.max(np.abs(found.error[:, 2])) < 0.45
    assert np.sqrt(np.mean(position**2)) < 0.14  # a fix alone: 0.141
    assert np.sqrt(np.mean(found.error[:, 2] ** 2)) < 0.12
    stds = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    # Learning from 45 innovations, `r` now and then holds R for half of what it is.
    assert np.max(np.abs(found.error) / stds) < {"none": 4.5, "r": 8.0}[adaptation]


@pytest.mark.parametrize("motion_model", ["exact_arc", "paper"])
@pytest.mark.slow
def test_covariances_stay_positive_definite_and_symmetric(
    errors: Callable[..., Errors], motion_model: str
) -> None:
    found = errors(7, 40.0, motion_model=motion_model, adaptation="q")
    np.testing.assert_array_equal(found.covariance, np.swapaxes(found.covariance, 1, 2))
    assert np.all(np.linalg.eigvalsh(found.covariance) > 0.0)


@pytest.mark.slow
def test_with_the_right_noise_the_covariance_is_right(errors: Callable[..., Errors]) -> None:
    """Mean NEES of 20 runs inside the 99 % band of its chi-square distribution.

    Errors are correlated in time, so not every sample counts. Their memory is the filter's own:
    per period about 1 - K remains of an error, at most 0.7 with this noise (yaw), and so at most
    0.7^2 of a squared one. Every sixth period (2.25 s) a squared error has forgotten all but
    0.7^12 = 1.4 % of itself, and samples so far apart count as independent. M samples of 3
    degrees of freedom: M times their mean is chi-square with 3 M, whose quantiles are here the
    normal ones, 3 +- 2.576 sqrt(6 / M) (M is about 300; Wilson-Hilferty differs by 0.005).
    """
    samples = np.concatenate([errors(seed).nees()[8::6] for seed in SEEDS])
    assert len(samples) > 280
    band = 2.576 * np.sqrt(6.0 / len(samples))
    assert abs(np.mean(samples) - 3.0) < band
    # As many beyond the 95 % quantile of chi-square(3), 7.815, as belong there: 99.9 % band.
    beyond = np.mean(samples > 7.815)
    assert abs(beyond - 0.05) < 3.29 * np.sqrt(0.05 * 0.95 / len(samples))


def test_with_the_right_noise_innovations_are_as_large_as_expected(
    errors: Callable[..., Errors],
) -> None:
    """NIS of a right filter is white, so every period counts: 99 % band as above.

    The robot's compass speaks three times a period, and all its readings count: five degrees of
    freedom with the two of the fix, and M sums of five are chi-square with 5 M.
    """
    nis = np.concatenate([errors(seed).nis for seed in SEEDS])
    assert set(np.concatenate([errors(seed).freedom for seed in SEEDS])) == {5.0}
    assert abs(np.mean(nis) - 5.0) < 2.576 * np.sqrt(10.0 / len(nis))


@pytest.mark.parametrize(("factor", "largest"), [(5.0, 1.08), (0.2, 1.08)], ids=["x25", "/25"])
@pytest.mark.slow
def test_r_finds_the_measurement_noise_from_a_start_wrong_by_25(
    errors: Callable[..., Errors], factor: float, largest: float
) -> None:
    """Second halves: nearly as good as with the right noise, and better than without learning."""
    start = {
        "measurement_noise_std": (0.1 * factor, 0.1 * factor, 0.134 * factor),
        "lrf_yaw_std": 0.134 * factor,
    }

    def rmse(**changes: Any) -> FloatArray:
        runs = [errors(seed, **changes).error for seed in SEEDS[:12]]
        return np.sqrt(np.mean([np.mean(e[len(e) // 2 :] ** 2, axis=0) for e in runs], axis=0))

    right, wrong, learned = rmse(), rmse(**start), rmse(adaptation="r", **start)
    assert np.all(learned < largest * right)
    assert np.all(learned < 0.95 * wrong)


@pytest.mark.slow
def test_slip_that_the_filter_does_not_expect_is_seen_in_nees(
    errors: Callable[..., Errors],
) -> None:
    """The test of the covariance above can fail: with Q a quarter of the truth it would."""
    samples = np.concatenate(
        [errors(seed, process_noise_std=(0.025, 0.026)).nees()[8::6] for seed in SEEDS[:6]]
    )
    assert np.mean(samples) > 3.0 + 2.576 * np.sqrt(6.0 / len(samples))
