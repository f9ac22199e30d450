# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Linear regression of a sensor's readings on the travel of wheels that slip.

Wheels slip, so what the wheels' travel does not explain of a reading is a random walk (slip) seen
through the sensor's own noise,

    y_k = c + X_k b + d_k + v_k,    d_k - d_(k-1) ~ N(0, q dt),    v_k ~ N(0, r).

This is the local level model with regressors (Harvey, "Forecasting, structural time series models
and the Kalman filter", 1989, sections 2.3 and 3.4). A Kalman filter over the drift d turns y and
every column of X into innovations of unit variance, on which least squares are efficient. The ratio
q / r is the one of highest likelihood. Outliers get less weight, round by round.

**Feedback.** A driver, or a planner, sees that the robot slipped and steers back, so travel depends
on slips of the past, and ordinary least squares find too little rotation: 15 % where slip and
steering are of one size. Travel never depends on slips of the future. So
the filter runs backward in time, which makes the errors a mixture of present and future ones, and
the travel that the filter saw running forward, up to the reading and no further, serves as
instruments (forward filtering, Hayashi and Sims, Econometrica 1983). Two-stage least squares on
both is consistent.

Real errors last longer than the model says. The covariance is the larger one of the model's and of
the sandwich over blocks of time (Liang and Zeger, Biometrika 1986).
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray

OUTLIER_FROM = 2.5
"""Innovation from which on a reading gets less weight [standard deviations]: with its fourth power,
so that the further an outlier is, the less it counts."""
LEAST_WEIGHT = 1e-9
"""Smallest weight of a reading: of a sensor without noise nearly all may be outliers."""
ROUNDS = 5
"""Rounds of weights and coefficients; more change neither by a tenth of a standard error."""
RATIOS = 10.0 ** np.arange(-5.0, 2.1, 0.5)
"""Ratios q / r that are tried [1/s]: from a sensor so noisy that wheels need no drift for hours, to
one so precise that each reading starts anew."""
BLOCK_S = 15.0
"""Length of the blocks of the sandwich covariance [s]: real fix errors last for seconds."""
FEWEST_BLOCKS = 6
"""Number of blocks that a covariance needs; shorter recordings get shorter blocks."""
NOTHING = 1e-100
"""Keeps divisions by sums of squares finite."""


class Drift(NamedTuple):
    """Readings with what is known of their noise.

    Attributes:
        times: `(n,)` rising [s].
        breaks: `(n,)` true where the drift starts anew, always for the first one.
        weights: `(n,)` 1 for most readings, less for outliers.
        ratio: q / r [1/s].
    """

    times: FloatArray
    breaks: BoolArray
    weights: FloatArray
    ratio: float

    def backward(self) -> "Drift":
        """Return the same with time reversed."""
        breaks = np.roll(self.breaks[::-1], 1)
        return Drift(-self.times[::-1], breaks, self.weights[::-1], self.ratio)


class DriftFit(NamedTuple):
    """Result of a regression.

    Attributes:
        coefficients: `(p,)` b.
        covariance: `(p, p)` of b.
        noise_std: sqrt(r), of one reading that is no outlier, in its unit.
        log_likelihood: of the readings, up to a constant; comparable among fits of the same ones.
        explained: share of the innovations of y that X explains, up to 1.
        drift: what the regression found out about the noise.
    """

    coefficients: FloatArray
    covariance: FloatArray
    noise_std: float
    log_likelihood: float
    explained: float
    drift: Drift


class Level(NamedTuple):
    """What a filter knows of the drift after a reading, to go on from.

    Attributes:
        variance: `(R,)` of the drift, in units of r.
        lead: `(R, m, q)` level of each column less its value at the reading, so that columns may be
            counted from elsewhere afterwards.
    """

    variance: FloatArray
    lead: FloatArray


class _Filtered(NamedTuple):
    """Columns as innovations, one set for each ratio.

    Attributes:
        white: `(n, R, m, q)` innovations of unit variance in units of r.
        spread: `(n, R)` their standard deviations; infinite where the drift starts.
        predicted: `(n, R)` variance of the drift before each reading.
        gain: `(n, R)`.
        level: after the last reading.
    """

    white: FloatArray
    spread: FloatArray
    predicted: FloatArray
    gain: FloatArray
    level: Level


def filtered(
    drift: Drift,
    columns: FloatArray,
    ratios: FloatArray | None = None,
    known: Level | None = None,
) -> _Filtered:
    """Return columns `(n, m, q)` as innovations of a Kalman filter over the drift.

    Args:
        drift: noise of the readings.
        columns: `(n, m, q)`.
        ratios: `(R,)` to filter with; None: that of the drift.
        known: after the first reading, which then is not counted again.
    """
    ratios = np.array([drift.ratio]) if ratios is None else ratios
    count, size = len(columns), len(ratios)
    steps = np.diff(drift.times, prepend=drift.times[:1])
    noise = 1.0 / drift.weights
    gain, spread = np.ones((count, size)), np.full((count, size), np.inf)
    predicted = np.zeros((count, size))
    variance = np.zeros(size)
    for k in range(count):
        if drift.breaks[k]:
            variance = np.full(size, noise[k]) if k or known is None else known.variance
            continue
        prior = variance + ratios * steps[k]
        total = prior + noise[k]
        gain[k] = prior / total
        spread[k], predicted[k] = total, prior
        variance = gain[k] * noise[k]
    spread = np.sqrt(spread)
    white = np.empty((count, size, *columns.shape[1:]), dtype=columns.dtype)
    level = np.broadcast_to(columns[0], white.shape[1:])
    if known is not None:
        level, gain[0] = level + known.lead, 0.0
    shaped = gain[:, :, None, None]
    for k in range(count):
        innovation = columns[k] - level
        white[k] = innovation
        level = level + shaped[k] * innovation
    end = Level(variance, level - columns[-1])
    return _Filtered(white / spread[:, :, None, None], spread, predicted, gain, end)


def fit_drifting(
    times: FloatArray, readings: FloatArray, columns: FloatArray, breaks: BoolArray
) -> DriftFit:
    """Return the coefficients that explain readings but for drift and noise, by least squares.

    Args:
        times: `(n,)` of the readings, rising [s].
        readings: `(n, m)` y; m channels share the statistics of drift and noise.
        columns: `(n, m, p)` X.
        breaks: `(n,)` true where the drift starts anew.
    """
    breaks = breaks.copy()
    breaks[0] = True
    together = np.concatenate([readings[..., None], columns], axis=-1)
    drift = Drift(times, breaks, np.ones(len(times)), float(RATIOS[0]))
    ratios = RATIOS
    for turn in range(ROUNDS):
        seen = filtered(drift, together, ratios)
        scores, coefficients = _scores(seen)
        best = int(np.argmax(scores))
        drift = drift._replace(
            ratio=float(ratios[best]), weights=_weights(seen, best, coefficients[best])
        )
        if turn:
            ratios = drift.ratio * 10.0 ** np.array([-0.25, 0.0, 0.25])
    return fit_with(drift, readings, columns)


def fit_with(drift: Drift, readings: FloatArray, columns: FloatArray) -> DriftFit:
    """Return the least squares fit with noise that is known from another fit."""
    seen = filtered(drift, np.concatenate([readings[..., None], columns], axis=-1))
    scores, coefficients = _scores(seen)
    white = seen.white[:, 0]
    fitted, left = white[..., 1:], white[..., 0] - white[..., 1:] @ coefficients[0]
    variance = float(np.sum(left**2)) / _freedom(seen, columns.shape[-1])
    return DriftFit(
        coefficients=coefficients[0],
        covariance=_covariance(drift.times, fitted, fitted, left, variance),
        noise_std=_robust_std(left[np.isfinite(seen.spread[:, 0])]),
        log_likelihood=float(scores[0]),
        explained=1.0 - float(np.sum(left**2) / (np.sum(white[..., 0] ** 2) + NOTHING)),
        drift=drift,
    )


def fit_with_instruments(
    drift: Drift, readings: FloatArray, columns: FloatArray, instruments: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return coefficients `(p,)` and their covariance by two-stage least squares.

    Args:
        drift: noise that is known from another fit.
        readings: `(n, m)` y.
        columns: `(n, m, p)` X.
        instruments: `(n, m, z)` of which each row depends on nothing after its reading, z >= p.
    """
    together = np.concatenate([readings[..., None], columns], axis=-1)
    white = filtered(drift.backward(), together[::-1]).white[::-1, 0]
    seen = filtered(drift, instruments).white[:, 0]
    seen = seen / (np.sqrt(np.mean(seen**2, axis=(0, 1))) + NOTHING)
    flat = seen.reshape(-1, seen.shape[-1])
    basis = np.linalg.qr(flat)[0]
    explained = white[..., 1:].reshape(len(flat), -1)
    projected = (basis @ (basis.T @ explained)).reshape(white[..., 1:].shape)
    scale = np.sqrt(np.mean(projected**2, axis=(0, 1))) + NOTHING
    first, second = projected / scale, white[..., 1:] / scale
    cross = np.einsum("kmi,kmj->ij", first, second)
    found = np.linalg.pinv(cross, rcond=1e-9) @ np.einsum("kmi,km->i", first, white[..., 0]) / scale
    left = white[..., 0] - white[..., 1:] @ found
    variance = float(np.sum(left**2)) / max(left.size - len(found), 1)
    return found, _covariance(drift.times, projected, white[..., 1:], left, variance)


def smoothed(drift: Drift, residuals: FloatArray) -> FloatArray:
    """Return c + d `(n,)` at each reading, by all readings (Rauch, Tung and Striebel 1965)."""
    seen = filtered(drift, residuals[:, None, None])
    gain, predicted = seen.gain[:, 0], seen.predicted[:, 0]
    level = np.empty(len(residuals))
    for k, value in enumerate(residuals):
        level[k] = value if drift.breaks[k] else level[k - 1] + gain[k] * (value - level[k - 1])
    variance = gain / drift.weights
    smooth = level.copy()
    for k in range(len(level) - 2, -1, -1):
        if not drift.breaks[k + 1]:
            back = variance[k] / max(predicted[k + 1], NOTHING)
            smooth[k] = level[k] + back * (smooth[k + 1] - level[k])
    return smooth


def profile(drift: Drift, readings: FloatArray, candidates: FloatArray) -> FloatArray:
    """Return the log likelihood `(c,)` of readings with each set of columns `(c, n, m, p)`."""
    sets, count, channels, size = candidates.shape
    flat = np.moveaxis(candidates, 0, 2).reshape(count, channels, sets * size)
    seen = filtered(drift, np.concatenate([readings[..., None], flat], axis=-1))
    found = []
    for each in range(sets):
        chosen = [0, *range(1 + each * size, 1 + (each + 1) * size)]
        found.append(_scores(seen._replace(white=seen.white[..., chosen]))[0][0])
    return np.array(found)


def _freedom(seen: _Filtered, size: int) -> int:
    readings = int(np.isfinite(seen.spread[:, 0]).sum()) * int(seen.white.shape[2])
    return max(readings - size, 1)


def _scores(seen: _Filtered) -> tuple[FloatArray, FloatArray]:
    """Return log likelihood `(R,)` and coefficients `(R, p)` for each ratio."""
    readings, columns = seen.white[..., 0], seen.white[..., 1:]
    scale = np.sqrt(np.mean(columns**2, axis=(0, 2))) + NOTHING
    scaled = columns / scale[:, None, :]
    normal = np.einsum("krmi,krmj->rij", scaled, scaled)
    moments = np.einsum("krmi,krm->ri", scaled, readings)
    inverse = np.linalg.pinv(normal, rcond=1e-9, hermitian=True)
    coefficients = np.einsum("rij,rj->ri", inverse, moments) / scale
    left = readings - np.einsum("krmi,ri->krm", columns, coefficients)
    variance = np.sum(left**2, axis=(0, 2)) / _freedom(seen, columns.shape[-1]) + NOTHING
    used = np.isfinite(seen.spread)
    channels = columns.shape[2]
    spread = channels * np.sum(np.log(np.where(used, seen.spread, 1.0)), axis=0)
    return -0.5 * channels * used.sum(axis=0) * np.log(variance) - spread, coefficients


def _weights(seen: _Filtered, at: int, coefficients: FloatArray) -> FloatArray:
    """Return the weight of each reading by what coefficients leave of it."""
    white = seen.white[:, at]
    left = white[..., 0] - white[..., 1:] @ coefficients
    return outlier_weights(left, seen.spread[:, at], seen.predicted[:, at])


def outlier_weights(left: FloatArray, spread: FloatArray, predicted: FloatArray) -> FloatArray:
    """Return the weight `(n,)` of each reading, judged as if it had the noise of a good one.

    Args:
        left: `(n, m)` what the fit leaves of the innovations, of unit variance in units of r.
        spread: `(n,)` as in `_Filtered`.
        predicted: `(n,)` likewise.
    """
    used = np.isfinite(spread)
    scale = _robust_std(left[used])
    plain = np.where(used, spread, 0.0)[:, None] * left
    size = np.sqrt(np.mean(plain**2, axis=-1) / (predicted + 1.0))
    relative = OUTLIER_FROM * max(scale, NOTHING) / np.maximum(size, NOTHING)
    return np.asarray(np.clip(relative, LEAST_WEIGHT**0.25, 1.0) ** 4)


def _robust_std(values: FloatArray) -> float:
    """Return the standard deviation of most values, by their median size."""
    return 1.4826 * float(np.median(np.abs(values))) if values.size else 1.0


def _covariance(
    times: FloatArray,
    projected: FloatArray,
    columns: FloatArray,
    left: FloatArray,
    variance: float,
) -> FloatArray:
    """Return the larger one of the model's covariance and of the sandwich over blocks.

    Args:
        times: `(n,)` [s].
        projected: `(n, m, p)` columns as the instruments explain them; the columns without any.
        columns: `(n, m, p)` innovations of the columns.
        left: `(n, m)` what they leave of the readings.
        variance: of these.
    """
    scale = np.sqrt(np.mean(columns**2, axis=(0, 1))) + NOTHING
    first, second = projected / scale, columns / scale
    bread = np.linalg.pinv(np.einsum("kmi,kmj->ij", first, second), rcond=1e-9)
    model = variance * bread @ np.einsum("kmi,kmj->ij", first, first) @ bread.T
    length = min(BLOCK_S, (times[-1] - times[0]) / FEWEST_BLOCKS) + 1e-9
    block = ((times - times[0]) / length).astype(int)
    sums = np.zeros((block[-1] + 1, columns.shape[-1]))
    np.add.at(sums, block, np.einsum("kmi,km->ki", first, left))
    blocks = len(np.unique(block))
    growth = blocks / max(blocks - columns.shape[-1], 1)
    sandwich = growth * bread @ sums.T @ sums @ bread.T
    return larger_covariance(model, sandwich) / np.outer(scale, scale)


def larger_covariance(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return a covariance that is nowhere smaller than either of two."""
    values, axes = np.linalg.eigh(0.5 * (one + one.T))
    root = axes * np.sqrt(np.maximum(values, NOTHING))
    unroot = (axes / np.sqrt(np.maximum(values, NOTHING))).T
    relative = unroot @ other @ unroot.T
    growth, turned = np.linalg.eigh(0.5 * (relative + relative.T))
    grown = (root @ turned) * np.sqrt(np.maximum(growth, 1.0))
    return np.asarray(grown @ grown.T, dtype=np.float64)
