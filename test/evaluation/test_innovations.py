# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""NIS, whiteness and rejections from the numbers of ~/noise."""

import numpy as np
import pytest
from localizers import SECOND_NS

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.evaluation.consistency import Verdict
from fnn_ekf_ros.evaluation.innovations import by_sensor, nis_consistency, whiteness
from fnn_ekf_ros.recordings.run_record import Noise


def noise_of(z: FloatArray, std: float = 0.2, rejected: FloatArray | None = None) -> Noise:
    """Return `~/noise` of fixes whose standardized innovations are z `(n, 2)`."""
    n = len(z)
    values = {"nis": np.sum(z**2, axis=1), "degrees_of_freedom": np.full(n, 2.0)}
    for i, name in enumerate(("x", "y")):
        values[f"innovation_{name}"] = std * z[:, i]
        values[f"innovation_variance_{name}"] = np.full(n, std**2)
    if rejected is not None:
        values["rejected_lrf_pose"] = rejected
    return Noise(SECOND_NS * np.arange(n), values)


def test_white_innovations_of_the_right_size_are_honest_and_white() -> None:
    noise = noise_of(np.random.default_rng(1).standard_normal((2000, 2)))
    assert nis_consistency(noise).verdict is Verdict.HONEST
    found = by_sensor(noise)
    assert list(found) == ["fixes"]
    assert found["fixes"].consistency.verdict is Verdict.HONEST
    assert found["fixes"].whiteness.white
    assert (found["fixes"].readings, found["fixes"].rejected) == (2000, 0)


@pytest.mark.parametrize(
    ("factor", "verdict"), [(1.5, Verdict.TOO_SURE), (0.6, Verdict.TOO_CAUTIOUS)]
)
def test_innovations_of_another_size_are_not(factor: float, verdict: Verdict) -> None:
    noise = noise_of(factor * np.random.default_rng(1).standard_normal((2000, 2)))
    assert nis_consistency(noise).verdict is verdict
    assert nis_consistency(noise).ratio == pytest.approx(factor**2, rel=0.1)


def test_rejected_readings_are_counted_and_left_out() -> None:
    z = np.random.default_rng(1).standard_normal((2000, 2))
    out = np.zeros(2000)
    out[::10] = 1.0
    z[::10] += 40.0
    found = by_sensor(noise_of(z, rejected=out))["fixes"]
    assert found.rejected_share == pytest.approx(0.1)
    assert found.consistency.verdict is Verdict.HONEST
    assert nis_consistency(noise_of(z, rejected=out)).verdict is Verdict.HONEST
    assert nis_consistency(noise_of(z)).verdict is Verdict.TOO_SURE


def test_lag_one_of_a_known_correlation() -> None:
    rng = np.random.default_rng(8)
    z = np.empty((4000, 1))
    z[0] = 0.0
    for k, white in enumerate(rng.standard_normal(3999), start=1):
        z[k] = 0.4 * z[k - 1] + white
    found = whiteness(z)
    assert found.lag_one == pytest.approx(0.4, abs=0.03)
    assert not found.white
    assert found.band == pytest.approx(1.96 / 4000**0.5, rel=1e-3)


def test_periods_without_a_reading_count_for_nothing() -> None:
    z = np.random.default_rng(2).standard_normal((600, 2))
    noise = noise_of(z)
    for values in noise.values.values():
        values[::3] = 0.0
    assert by_sensor(noise)["fixes"].readings == 400
    assert nis_consistency(noise).size == 400
    assert not noise.measured(Row.COMPASS_YAW).any()


def test_a_handful_of_readings_says_nothing() -> None:
    noise = noise_of(np.ones((5, 2)))
    assert by_sensor(noise) == {}
    assert nis_consistency(noise).verdict is Verdict.UNKNOWN
