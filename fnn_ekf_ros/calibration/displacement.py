# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Distance by the wheels, in the direction that a yaw sensor shows, against the fixes.

In complex numbers x + i y, with the sensor's yaw, the mean s and the half difference d of the
wheels' travel in counts,

    p(t) = c + e^(i g) (b_s D_s(t - delay) + b_d D_d(t - delay)),    D_s = integral e^(i yaw) ds.

g is by how much the true yaw is ahead of the sensor's. If the yaw counts clockwise, or the fixes
are mirrored, the fit is with -yaw. A robot that is wired as it should be has b_s > 0 and, if its
wheels are equal, b_d = 0.
"""

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros.calibration.drift_regression import DriftFit, fit_drifting, fit_with, profile
from fnn_ekf_ros.calibration.rotation import DELAY_STEP_S, LARGEST_DELAY_S, RATE_HALF_WINDOW_S
from fnn_ekf_ros.calibration.travel import WheelTravel
from fnn_ekf_ros.core.arrays import FloatArray

MIRROR_MARGIN = 10.0
"""Log likelihood by which a mirrored yaw has to fit the fixes better [nats]."""
ComplexArray = NDArray[np.complex128]
"""Array of complex numbers x + i y."""


class DisplacementFit(NamedTuple):
    """What fixes say of wheels and yaw.

    Attributes:
        coefficients: `(4,)` b_s, b_d [m per count], g [rad], delay [s]; both b of the other sign
            with g + pi say the same.
        covariance: `(4, 4)` of these.
        noise_std: of a fix, along x or y [m].
        explained: share of the changes of the fixes that wheels and yaw explain.
        log_likelihood: up to a constant, comparable among fits to the same fixes.
        readings: number of fixes.
    """

    coefficients: FloatArray
    covariance: FloatArray
    noise_std: float
    explained: float
    log_likelihood: float
    readings: int


def fit_displacement(
    travel: WheelTravel, yaw: FloatArray, times: FloatArray, positions: FloatArray
) -> tuple[DisplacementFit, int]:
    """Return how fixes depend on the wheels' travel in the direction of a yaw, and handedness.

    The handedness is +1 if the fixes' path goes the way the yaw says, -1 if it is mirrored, and 0
    if that cannot be told; the fit is with -yaw if it is -1.

    Args:
        travel: of the wheels.
        yaw: `(n,)` at the travel's times, unwrapped [rad].
        times: `(k,)` stamps of the fixes, rising [s].
        positions: `(k, 2)` x, y of the fixes [m].
    """
    breaks = travel.breaks(times)
    paths = [dead_reckoned(travel, sign * yaw) for sign in (1.0, -1.0)]
    fits = [
        fit_drifting(times, positions, _free(displaced_at(travel, path, times)), breaks)
        for path in paths
    ]
    margin = fits[0].log_likelihood - fits[1].log_likelihood
    handedness = 0 if abs(margin) < MIRROR_MARGIN else (1 if margin > 0.0 else -1)
    chosen = 1 if handedness < 0 else 0
    return _refined(travel, paths[chosen], fits[chosen], positions), handedness


def _refined(
    travel: WheelTravel, travelled: ComplexArray, fit: DriftFit, positions: FloatArray
) -> DisplacementFit:
    """Return a fit with a delay and with both coefficients along one direction."""
    times = fit.drift.times
    moved = displaced_at(travel, travelled, times)
    delays = np.arange(-LARGEST_DELAY_S, LARGEST_DELAY_S + 1e-9, DELAY_STEP_S)
    shifted = np.stack([_free(displaced_at(travel, travelled, times - each)) for each in delays])
    delay = float(delays[int(np.argmax(profile(fit.drift, positions, shifted)))])
    primary, direction = _primary(fit, moved)
    refined = fit
    for _ in range(4):
        columns, ahead, behind = (
            _along(displaced_at(travel, travelled, times - delay + shift), primary, direction)
            for shift in (0.0, RATE_HALF_WINDOW_S, -RATE_HALF_WINDOW_S)
        )
        slope = fit_with(fit.drift, positions, columns).coefficients
        speed = (ahead - behind) @ slope / (2.0 * RATE_HALF_WINDOW_S)
        refined = fit_with(
            fit.drift, positions, np.concatenate([columns, -speed[..., None]], axis=-1)
        )
        step = float(np.clip(refined.coefficients[3], -0.2, 0.2))
        delay = float(np.clip(delay + step, -LARGEST_DELAY_S, LARGEST_DELAY_S))
        turned = math.atan2(refined.coefficients[1], refined.coefficients[0])
        if abs(step) < 2e-3 and abs(turned) < 1e-4:
            break
        direction *= complex(math.cos(turned), math.sin(turned))
    return _result(refined, primary, direction, delay)


def _result(fit: DriftFit, primary: int, direction: complex, delay: float) -> DisplacementFit:
    """Return b_s, b_d, g and the delay of coefficients along and across a direction."""
    along, across, other, _ = fit.coefficients
    size = math.hypot(along, across)
    turned = math.atan2(across, along)
    # Along the refined direction: the primary coefficient by its length, the other as it is.
    to_result = np.zeros((4, 4))
    to_result[primary, :2] = along / size, across / size
    to_result[1 - primary, 2] = 1.0
    to_result[2, :2] = -across / size**2, along / size**2
    to_result[3, 3] = 1.0
    coefficients = np.zeros(4)
    coefficients[primary], coefficients[1 - primary] = size, other
    coefficients[2] = math.remainder(cmath.phase(direction) + turned, 2.0 * math.pi)
    coefficients[3] = delay
    return DisplacementFit(
        coefficients=coefficients,
        covariance=to_result @ fit.covariance @ to_result.T,
        noise_std=fit.noise_std,
        explained=fit.explained,
        log_likelihood=fit.log_likelihood,
        readings=len(fit.drift.times),
    )


def dead_reckoned(travel: WheelTravel, yaw: FloatArray) -> ComplexArray:
    """Return D_s and D_d `(n, 2)`, complex, at the travel's times; each step is an arc."""
    middle, half = 0.5 * (yaw[1:] + yaw[:-1]), 0.5 * (yaw[1:] - yaw[:-1])
    chord = np.exp(1j * middle) * np.sinc(half / np.pi)
    steps = np.diff(travel.mean_and_half_difference(travel.times), axis=0) * chord[:, None]
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def displaced_at(travel: WheelTravel, travelled: ComplexArray, times: FloatArray) -> ComplexArray:
    """Return D_s and D_d `(..., 2)` at instants."""
    parts = [
        np.interp(times, travel.times, travelled[:, each].real)
        + 1j * np.interp(times, travel.times, travelled[:, each].imag)
        for each in (0, 1)
    ]
    return np.stack(parts, axis=-1)


def _free(moved: ComplexArray) -> FloatArray:
    """Return columns `(n, 2, 4)` of displacements `(n, 2)` with complex coefficients."""
    return _real([moved[:, 0], 1j * moved[:, 0], moved[:, 1], 1j * moved[:, 1]])


def _along(moved: ComplexArray, primary: int, direction: complex) -> FloatArray:
    """Return columns `(n, 2, 3)`: one displacement along and across, the other one along."""
    first, second = direction * moved[:, primary], direction * moved[:, 1 - primary]
    return _real([first, 1j * first, second])


def _real(parts: Sequence[ComplexArray]) -> FloatArray:
    return np.stack([np.stack([part.real, part.imag], axis=-1) for part in parts], axis=-1)


def _primary(fit: DriftFit, moved: ComplexArray) -> tuple[int, complex]:
    """Return which of the two displacements says more of the fixes, and the direction by it."""
    coefficients = [complex(*fit.coefficients[:2]), complex(*fit.coefficients[2:4])]
    sizes = np.sqrt(np.mean(np.abs(np.diff(moved, axis=0)) ** 2, axis=0)) * np.abs(coefficients)
    primary = int(np.argmax(sizes))
    return primary, coefficients[primary] / (abs(coefficients[primary]) + 1e-300)
