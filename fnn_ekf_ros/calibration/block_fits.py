# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The fits of `rotation` and `displacement`, from sums over blocks of readings (`block_sums`)."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.calibration.block_sums import (
    COLUMNS,
    NODES_S,
    BlockSums,
    NumberArray,
    total,
    travel_at,
)
from fnn_ekf_ros.calibration.displacement import MIRROR_MARGIN, DisplacementFit
from fnn_ekf_ros.calibration.drift_regression import NOTHING, larger_covariance
from fnn_ekf_ros.calibration.rotation import (
    DELAY_STEP_S,
    EXPLAINED,
    INSTRUMENT_LAGS_S,
    LARGEST_DELAY_S,
    WEAK_DELAY_STD_S,
    YawFit,
)
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.sensor_lag import COLOR, PRIOR_BLOCKS

ROUNDS = 4
"""Rounds of Gauss-Newton: the start is the best one of a grid."""
FEEDBACK_STD_S = 0.08
"""What a delay by least squares may be off by, as a standard deviation, where instruments do not
tell it [s]: a robot that is steered by its true position seems to be late by up to 0.15 s."""
RIDGE = 1e-9
"""Keeps normal equations solvable where a robot only drives straight, as a part of the diagonal."""
_DELAYS_S = DELAY_STEP_S * np.arange(-14, 15)
"""Delays that are tried first [s]; travel at the outermost ones is not interpolated well."""


def _selection(delay_s: float) -> FloatArray:
    """Return the `(c, 3)` matrix of reading, mean and half difference of travel at a delay."""
    found = np.zeros((COLUMNS, 3))
    found[0, 0] = 1.0
    found[1 : 1 + len(NODES_S), 1] = found[1 + len(NODES_S) :, 2] = travel_at(delay_s)[0]
    return found


_SELECTIONS = np.stack([_selection(float(delay)) for delay in _DELAYS_S])
_UNDELAYED = int(np.argmin(np.abs(_DELAYS_S)))


class _Start(NamedTuple):
    """The best fit on the grid of delays and ratios.

    Attributes:
        coefficients: `(2,)` of mean and half difference.
        delay: [s].
        ratio: place in `BLOCK_RATIOS`.
        log_likelihood: up to a constant.
    """

    coefficients: NumberArray
    delay: float
    ratio: int
    log_likelihood: float


def _start(sums: BlockSums, *, mirrored: bool = False, delayed: bool = True) -> _Start:
    """Return the best fit on the grid.

    Args:
        sums: over blocks.
        mirrored: whether the travel is mirrored.
        delayed: whether there may be a delay at all.
    """
    gram = _mirrored(sums) if mirrored else sums.gram
    parts = 2 if np.iscomplexobj(gram) else 1
    chosen = _SELECTIONS if delayed else _SELECTIONS[_UNDELAYED : _UNDELAYED + 1]
    small = np.swapaxes(chosen[:, None], -1, -2) @ (gram[None] @ chosen[:, None])
    normal, moments = small[..., 1:, 1:], small[..., 1:, 0]
    scale = np.sqrt(np.einsum("...ii->...i", normal).real) + NOTHING
    scaled = normal / (scale[..., :, None] * scale[..., None, :]) + RIDGE * np.eye(2)
    found = np.linalg.solve(scaled, (moments / scale)[..., None])[..., 0] / scale
    left = small[..., 0, 0].real - np.sum(np.conj(moments) * found, axis=-1).real
    freedom = max(parts * sums.used - 2 * parts, 1)
    variance = np.maximum(left, 0.0) / freedom + NOTHING
    scores = -0.5 * parts * sums.used * np.log(variance) - parts * sums.spread
    place, ratio = np.unravel_index(int(np.argmax(scores)), scores.shape)
    delay = float(_DELAYS_S[place]) if delayed else 0.0
    return _Start(found[place, ratio], delay, int(ratio), float(scores[place, ratio]))


def _mirrored(sums: BlockSums) -> NumberArray:
    """Return the gram `(R, c, c)` of the reading and of the mirrored travel."""
    found = np.conj(sums.gram)
    found[:, 0, 0] = sums.gram[:, 0, 0]
    found[:, 1:, 0] = sums.plain[:, 1:]
    found[:, 0, 1:] = np.conj(sums.plain[:, 1:])
    return found


Model = Callable[[FloatArray], tuple[NumberArray, NumberArray]]
"""Coefficients `(c,)` of the columns, and their derivative `(c, p)`, of parameters `(p,)`; the last
one is the delay."""


def _stepped(x: FloatArray, step: FloatArray) -> FloatArray:
    found = x + step
    found[-1] = np.clip(x[-1] + np.clip(step[-1], -0.2, 0.2), -LARGEST_DELAY_S, LARGEST_DELAY_S)
    return found


def _left(coefficients: NumberArray) -> NumberArray:
    """Return the combination of the columns that a fit leaves: the reading less its travel."""
    found = -coefficients
    found[0] += 1.0
    return found


def _solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    scale = np.sqrt(np.abs(np.diag(normal))) + NOTHING
    scaled = normal / np.outer(scale, scale) + RIDGE * np.eye(len(scale))
    return np.asarray(np.linalg.solve(scaled, right / scale) / scale)


def _covariance(normal: FloatArray, variance: float, scores: FloatArray) -> FloatArray:
    """Return the larger one of the model's covariance and of the sandwich over blocks.

    Few blocks may agree by chance, so the sandwich is averaged with what is usual, as in
    `core.sensor_lag`.

    Args:
        normal: `(p, p)`.
        variance: of the innovations.
        scores: `(b, p)` of each block.
    """
    scale = np.sqrt(np.abs(np.diag(normal))) + NOTHING
    bread = np.linalg.inv(normal / np.outer(scale, scale) + RIDGE * np.eye(len(scale)))
    model, scaled, blocks = variance * bread, scores / scale, len(scores)
    seen = blocks / max(blocks - 1, 1) * bread @ scaled.T @ scaled @ bread.T
    sandwich = (blocks * seen + PRIOR_BLOCKS * COLOR * model) / (blocks + PRIOR_BLOCKS)
    return np.asarray(
        larger_covariance(np.asarray(model), np.asarray(sandwich)) / np.outer(scale, scale)
    )


class _Fitted(NamedTuple):
    """A fit by least squares, or by two stages of them.

    Attributes:
        x: `(p,)` the parameters.
        covariance: `(p, p)`.
        variance: of the innovations.
        explained: share of the readings' innovations that travel explains.
    """

    x: FloatArray
    covariance: FloatArray
    variance: float
    explained: float


def _least_squares(
    blocks: list[NumberArray], model: Model, x: FloatArray, parts: int, used: int
) -> _Fitted:
    """Return the fit by Gauss-Newton.

    Args:
        blocks: grams `(c, c)` of the blocks.
        model: of the parameters.
        x: `(p,)` to begin with.
        parts: 2 for complex readings, otherwise 1.
        used: number of innovations.
    """
    gram = sum(blocks[1:], start=blocks[0])
    normal = np.eye(len(x))
    for _ in range(ROUNDS):
        coefficients, slope = model(x)
        weighed = np.conj(slope.T) @ gram
        normal = np.real(weighed @ slope)
        x = _stepped(x, _solved(normal, np.real(weighed @ _left(coefficients))))
    coefficients, slope = model(x)
    left = _left(coefficients)
    scores = np.real((np.stack(blocks) @ left) @ np.conj(slope))
    squares = max(float(np.real(np.conj(left) @ gram @ left)), 0.0)
    variance = squares / max(parts * used - len(x), 1)
    return _Fitted(
        x=x,
        covariance=_covariance(normal, variance, scores),
        variance=variance,
        explained=1.0 - squares / (float(np.real(gram[0, 0])) + NOTHING),
    )


def _with_instruments(blocks: list[BlockSums], model: Model, x: FloatArray) -> _Fitted:
    """Return the fit by two-stage least squares, free of the driver's feedback.

    Instruments are the innovations of earlier travel with time running forward; see
    `drift_regression`.
    """
    sums = total(blocks)
    normal, projection, chosen = np.eye(len(x)), np.zeros((0, len(x))), np.zeros((COLUMNS, 0))
    for _ in range(ROUNDS):
        coefficients, slope = model(x)
        chosen = _instruments(float(x[-1]))
        squares = chosen.T @ sums.instruments @ chosen
        scale = np.sqrt(np.diag(squares)) + NOTHING
        inverse = np.linalg.pinv(squares / np.outer(scale, scale), rcond=1e-7, hermitian=True)
        shown = chosen.T @ sums.cross @ slope
        projection = inverse @ (shown / scale[:, None]) / scale[:, None]
        normal = shown.T @ projection
        right = projection.T @ (chosen.T @ sums.cross @ _left(coefficients))
        x = _stepped(x, _solved(normal, right))
    coefficients, _ = model(x)
    left = _left(coefficients)
    crosses = np.stack([block.cross for block in blocks])
    scores = (crosses @ left) @ (chosen @ projection)
    squares_left = max(float(left @ sums.backward @ left), 0.0)
    variance = squares_left / max(sums.used - len(x), 1)
    return _Fitted(x, _covariance(normal, variance, scores), variance, 0.0)


def _instruments(delay_s: float) -> FloatArray:
    """Return the columns `(c, z)` of travel that depends on nothing after a delayed reading."""
    lags = [min(delay_s + lag, float(NODES_S[-1])) for lag in INSTRUMENT_LAGS_S]
    return np.concatenate([_selection(lag)[:, 1:] for lag in lags], axis=1)


def _rotation(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the model of yaw: a_s, a_d, delay."""
    weights, slopes = travel_at(float(x[2]))
    coefficients, slope = np.zeros(COLUMNS), np.zeros((COLUMNS, 3))
    for at, part in enumerate((slice(1, 1 + len(NODES_S)), slice(1 + len(NODES_S), COLUMNS))):
        coefficients[part] = x[at] * weights
        slope[part, at] = weights
        slope[part, 2] = x[at] * slopes
    return coefficients, slope


def _rotation_at(delay_s: float) -> Model:
    """Return the model of yaw with a delay that is not estimated."""

    def model(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        coefficients, slope = _rotation(np.array([x[0], x[1], delay_s]))
        slope[:, 2] = 0.0
        return coefficients, slope

    return model


def _displacement(x: FloatArray) -> tuple[NumberArray, NumberArray]:
    """Return the model of positions: b_s, b_d, g, delay."""
    weights, slopes = travel_at(float(x[3]))
    direction = complex(math.cos(x[2]), math.sin(x[2]))
    coefficients = np.zeros(COLUMNS, dtype=np.complex128)
    slope = np.zeros((COLUMNS, 4), dtype=np.complex128)
    for at, part in enumerate((slice(1, 1 + len(NODES_S)), slice(1 + len(NODES_S), COLUMNS))):
        coefficients[part] = x[at] * direction * weights
        slope[part, at] = direction * weights
        slope[part, 3] = x[at] * direction * slopes
    slope[:, 2] = 1j * coefficients
    return coefficients, slope


def likeliest_ratio(blocks: list[BlockSums]) -> int:
    """Return the place of the likeliest ratio of noise, for fits without a delay."""
    return _start(total(blocks), delayed=False).ratio


def rotation_of_blocks(blocks: list[BlockSums], taken_off_s: float) -> YawFit:
    """Return how a yaw depends on the wheels.

    Args:
        blocks: sums of the yaw's readings.
        taken_off_s: delay that was taken off its stamps where it gave directions [s].
    """
    sums = total(blocks)
    start = _start(sums)
    x = np.array([*start.coefficients, start.delay if abs(start.delay) > DELAY_STEP_S else 0.0])
    grams = [block.gram[start.ratio] for block in blocks]
    fitted = _least_squares(grams, _rotation, x, 1, sums.used)
    instruments = fitted.explained < EXPLAINED
    found = _with_instruments(blocks, _rotation, fitted.x) if instruments else fitted
    if math.sqrt(found.covariance[2, 2]) > WEAK_DELAY_STD_S:
        std_s = math.hypot(math.sqrt(fitted.covariance[2, 2]), FEEDBACK_STD_S)
        delay_s = float(fitted.x[2])
        if std_s > WEAK_DELAY_STD_S:
            delay_s, std_s = 0.0, LARGEST_DELAY_S
        x, model = np.array([*fitted.x[:2], delay_s]), _rotation_at(delay_s)
        found = (
            _with_instruments(blocks, model, x)
            if instruments
            else _least_squares(grams, model, x, 1, sums.used)
        )
        found.x[2] = delay_s
        found.covariance[2, :] = found.covariance[:, 2] = 0.0
        found.covariance[2, 2] = std_s**2
    return YawFit(
        coefficients=found.x,
        covariance=found.covariance,
        noise_std=math.sqrt(fitted.variance),
        explained=fitted.explained,
        readings=sums.readings,
        level_delay_s=taken_off_s,
    )


def displacement_of_blocks(blocks: list[BlockSums]) -> tuple[DisplacementFit, int]:
    """Return how fixes depend on the wheels' travel in the direction of a yaw, and handedness.

    See `displacement.fit_displacement`.
    """
    sums = total(blocks)
    margin = _start(sums, delayed=False).log_likelihood - (
        _start(sums, mirrored=True, delayed=False).log_likelihood
    )
    handedness = 0 if abs(margin) < MIRROR_MARGIN else (1 if margin > 0.0 else -1)
    mirrored = handedness < 0
    start = _start(sums, mirrored=mirrored)
    grams = [(_mirrored(block) if mirrored else block.gram)[start.ratio] for block in blocks]
    gram = sum(grams[1:], start=grams[0])
    seen = np.real(np.diag(_SELECTIONS[_UNDELAYED].T @ gram @ _SELECTIONS[_UNDELAYED]))[1:]
    primary = int(np.argmax(np.sqrt(seen) * np.abs(start.coefficients)))
    direction = start.coefficients[primary] / (abs(start.coefficients[primary]) + NOTHING)
    along = np.real(start.coefficients * np.conj(direction))
    x = np.array([*along, np.angle(direction), start.delay])
    fitted = _least_squares(grams, _displacement, x, 2, sums.used)
    x, covariance = fitted.x, fitted.covariance
    if x[primary] < 0.0:
        signs = np.array([-1.0, -1.0, 1.0, 1.0])
        x = signs * x + [0.0, 0.0, math.pi, 0.0]
        covariance = covariance * np.outer(signs, signs)
    x[2] = math.remainder(x[2], 2.0 * math.pi)
    fit = DisplacementFit(
        coefficients=x,
        covariance=covariance,
        noise_std=math.sqrt(fitted.variance),
        explained=fitted.explained,
        log_likelihood=start.log_likelihood,
        readings=sums.readings,
    )
    return fit, handedness
