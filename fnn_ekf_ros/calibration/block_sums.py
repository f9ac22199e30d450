# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A block of readings as sums, from which regressions with any delay can be solved later.

`drift_regression` needs all readings of a drive at once. While driving, each block of readings is
filtered once, from where the filter was after the block before, and only the products of the
innovations are kept:

    G = sum w* w'     w: innovations of [reading, wheels' travel earlier by each of NODES_S]

Travel at a delay in between is interpolated, so it is a linear combination of these columns. Least
squares with any delay, the log likelihood, two-stage least squares and the sandwich over blocks
all follow from the sums: their size does not depend on the length of the drive.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros.calibration.drift_regression import (
    NOTHING,
    Drift,
    Level,
    filtered,
    outlier_weights,
)
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray

NODE_STEP_S = 0.3
"""Step of the delays of which travel is kept [s]: speeds hardly change within it."""
NODES_S = NODE_STEP_S * np.arange(-5, 6)
"""Delays of which travel is kept [s]: those that `rotation` looks for."""
COLUMNS = 1 + 2 * len(NODES_S)
"""Number of columns: the reading, and mean and half difference of the wheels at each delay."""
BLOCK_RATIOS = 10.0 ** np.arange(-4.0, 1.1)
"""Ratios q / r for which sums are kept [1/s]: a wrong one by a factor of 3 costs a few percent of
precision."""
USUAL_RATIO = 2
"""Which of them is assumed before any is known."""
FEWEST_IN_BLOCK = 5
"""Number of readings from which on a block says something: two coefficients and an offset are
estimated from it if nothing is known before."""

LONGEST_STEP_S = 1.5
"""Time between two readings above which they are not compared [s]: a robot may turn by more than pi
meanwhile, and slip is not small beside the readings' noise."""

NumberArray = NDArray[Any]
"""Array of real numbers, or of complex numbers x + i y."""


class BlockSums(NamedTuple):
    """Sums over the readings of a block, or of several blocks.

    Attributes:
        gram: `(R, c, c)` w* w' for each ratio; column 0 is the reading.
        plain: `(R, c)` w times w_0, not conjugated: what a mirrored reading has in place of
            `gram[:, 1:, 0]`.
        instruments: `(c, c)` w* w' at one ratio.
        cross: `(c, c)` w* v', v the innovations with time reversed; 0 for positions.
        backward: `(c, c)` v* v'.
        spread: `(R,)` sum of the logs of the innovations' standard deviations.
        used: number of innovations.
        readings: number of readings.
    """

    gram: NumberArray
    plain: NumberArray
    instruments: NumberArray
    cross: NumberArray
    backward: NumberArray
    spread: FloatArray
    used: int
    readings: int


def block_sums(
    times: FloatArray,
    columns: NumberArray,
    breaks: BoolArray,
    known: NumberArray | None,
    ratio: int,
    level: Level | None = None,
) -> tuple[BlockSums, Level]:
    """Return the sums of a block, and the level at its end.

    Args:
        times: `(n,)` of the readings, rising [s]; with `level` the first one is the last one of the
            block before.
        columns: `(n, c)` readings, and travel at the nodes.
        breaks: `(n,)` true where the drift starts anew.
        known: `(c - 1,)` coefficients of the travel, to find outliers by; None: the block's own.
        ratio: place of the likeliest ratio so far.
        level: after the block before, for each of `BLOCK_RATIOS`; None: there was none.
    """
    breaks = breaks | (np.diff(times, prepend=times[0]) > LONGEST_STEP_S)
    breaks[0] = True
    drift = Drift(times, breaks, np.ones(len(times)), float(BLOCK_RATIOS[ratio]))
    channels = columns[:, None, :]
    seen = filtered(drift, channels)
    white = seen.white[:, 0, 0]
    coefficients = _own(white) if known is None else known
    left = white[:, 0] - white[:, 1:] @ coefficients
    parts = np.stack([left.real, left.imag], axis=-1) if np.iscomplexobj(left) else left[:, None]
    weights = outlier_weights(parts, seen.spread[:, 0], seen.predicted[:, 0])
    drift = drift._replace(weights=weights)
    seen = filtered(drift, channels, BLOCK_RATIOS, level)
    forward = np.moveaxis(seen.white[:, :, 0], 0, 1)
    used = np.isfinite(seen.spread[:, 0])
    at_ratio = forward[ratio]
    reversed_ = np.zeros_like(at_ratio)  # positions are fitted without instruments
    if not np.iscomplexobj(columns):
        reversed_ = filtered(drift.backward(), channels[::-1]).white[::-1, 0, 0]
    sums = BlockSums(
        gram=np.conj(np.swapaxes(forward, 1, 2)) @ forward,
        plain=np.einsum("rkc,rk->rc", forward, forward[..., 0]),
        instruments=np.conj(at_ratio.T) @ at_ratio,
        cross=np.conj(at_ratio.T) @ reversed_,
        backward=np.conj(reversed_.T) @ reversed_,
        spread=np.sum(np.log(seen.spread[used]), axis=0),
        used=int(used.sum()),
        readings=len(times) - (level is not None),
    )
    return sums, seen.level


def total(blocks: list[BlockSums]) -> BlockSums:
    """Return the sums over several blocks."""
    return BlockSums(*(sum(parts[1:], start=parts[0]) for parts in zip(*blocks, strict=True)))


def travel_at(delay_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the weights of the nodes `(11,)` for travel at a delay, and their slopes [1/s].

    The cubic through the four nearest nodes.
    """
    place = (delay_s - NODES_S[0]) / NODE_STEP_S
    first = int(np.clip(np.floor(place) - 1, 0, len(NODES_S) - 4))
    x = place - first
    weights, slopes = np.zeros(len(NODES_S)), np.zeros(len(NODES_S))
    for node in range(4):
        others = [other for other in range(4) if other != node]
        scale = np.prod([node - other for other in others])
        a, b, c = (x - other for other in others)
        weights[first + node] = a * b * c / scale
        slopes[first + node] = (a * b + a * c + b * c) / scale / NODE_STEP_S
    return weights, slopes


def _own(white: NumberArray) -> NumberArray:
    """Return coefficients `(c - 1,)` of the travel without a delay, of a block by itself."""
    places = [len(NODES_S) // 2, len(NODES_S) + len(NODES_S) // 2]
    columns = white[:, 1:][:, places]
    scale = np.sqrt(np.mean(np.abs(columns) ** 2, axis=0)) + NOTHING
    scaled = columns / scale
    normal = np.conj(scaled.T) @ scaled + 1e-6 * len(white) * np.eye(2)
    found = np.zeros(white.shape[1] - 1, dtype=white.dtype)
    found[places] = np.linalg.solve(normal, np.conj(scaled.T) @ white[:, 0]) / scale
    return found
