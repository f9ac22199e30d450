# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How well the recordings tell what was fitted: standard errors and profiles.

With the information H of the objective and the covariance J of its gradient, the covariance of what
was fitted is H^-1 J H^-1 (Godambe 1960; Varin, Reid and Firth 2011). J is summed over pairs of
contributions that are less than a bandwidth apart, with Bartlett's weights (Newey and West 1987):
errors that last make neighboring contributions alike, and windows of outages overlap.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.lasting.outages import WINDOW
from fnn_ekf_ros.tuning.fit import Fit
from fnn_ekf_ros.tuning.objective import Timed, term_values
from fnn_ekf_ros.tuning.quantities import Quantity, with_coordinates
from fnn_ekf_ros.tuning.recording import HORIZONS_S, TuningRecording

QUANTILE = 1.96
"""Standard errors to each side of a 95 % interval."""
NEXT_READING_BANDWIDTH_S = 10.0
"""Bandwidth where next readings are trusted [s]: their contributions are then hardly correlated."""
OUTAGE_BANDWIDTH_S = (1.0 + WINDOW) * max(HORIZONS_S)
"""Bandwidth where outages decide [s]: the length of the longest outage with its window."""
_BINS = 8
"""Parts of a bandwidth in which contributions are summed before they are paired."""
PROFILE_POINTS: FloatArray = np.linspace(-3.0, 3.0, 13)
"""Points of a profile, in standard errors from the optimum."""
_WIDEST = 2.0
"""Largest standard error in a profile's range [coordinates]: a factor of 7 in a deviation."""
_VAGUE_INFORMATION = 0.1
"""Information that each coordinate is taken to have besides: that it is known to 3, a factor of 20
in a deviation. What the recordings cannot tell apart then has this error instead of none."""
_SMALLEST_INFORMATION = 1e-6
"""Information below which a quantity is not seen at all."""


class Interval(NamedTuple):
    """What was found of a quantity.

    Attributes:
        quantity: which.
        coordinate: the optimum.
        std: standard error of the coordinate; infinite if nothing is known.
        at_bound: whether the search ended at the smallest or largest value that is allowed.
    """

    quantity: Quantity
    coordinate: float
    std: float
    at_bound: bool


class Profile(NamedTuple):
    """The objective along a quantity, the others following it.

    Attributes:
        quantity: which.
        values: `(m,)` of it.
        log_likelihood: `(m,)` the objective less its largest value [nats].
    """

    quantity: Quantity
    values: FloatArray
    log_likelihood: FloatArray


def intervals(fit: Fit) -> tuple[Interval, ...]:
    """Return what was found of each quantity of a fit."""
    low, high = fit.limits
    at_bound = (fit.coordinate <= low) | (fit.coordinate >= high)
    information = _information(fit)
    free = np.flatnonzero(~at_bound & (np.diag(information) > _SMALLEST_INFORMATION))
    std = np.full(len(fit.which), np.inf)
    vague = _VAGUE_INFORMATION * np.eye(len(free))
    inverse = np.linalg.inv(information[np.ix_(free, free)] + vague)
    full = fit.trusts_next_readings
    bandwidth = NEXT_READING_BANDWIDTH_S if full else OUTAGE_BANDWIDTH_S
    weights = fit.weights.each()
    J = sum(gradient_covariance(timed, weights, bandwidth) for timed in fit.slopes.timed)
    sandwich = inverse @ (np.asarray(J)[np.ix_(free, free)] + vague) @ inverse
    std[free] = np.sqrt(np.maximum(np.diag(sandwich), np.diag(inverse)))
    return tuple(
        Interval(quantity, float(u), float(s), bool(at))
        for quantity, u, s, at in zip(fit.which, fit.coordinate, std, at_bound, strict=True)
    )


def _information(fit: Fit) -> FloatArray:
    found: FloatArray = np.einsum("t,tij->ij", fit.weights.each(), fit.slopes.information)
    return found


def gradient_covariance(timed: Timed, weights: FloatArray, bandwidth_s: float) -> FloatArray:
    """Return the covariance `(p, p)` of the gradient of a recording's contributions.

    Args:
        timed: the contributions.
        weights: `(4,)` of the terms.
        bandwidth_s: time apart from which on contributions are independent [s].
    """
    contribution = np.einsum("t,tkp->kp", weights, timed.score)
    bins = np.floor((timed.time_s - timed.time_s[0]) * (_BINS / bandwidth_s)).astype(np.intp)
    summed = np.zeros((int(bins[-1]) + 1, contribution.shape[1]))
    np.add.at(summed, bins, contribution)
    summed -= summed.mean(axis=0)
    J = summed.T @ summed
    for lag in range(1, min(_BINS, len(summed))):
        pairs = summed[lag:].T @ summed[:-lag]
        J += (1.0 - lag / _BINS) * (pairs + pairs.T)
    return J


def profiles(
    recordings: Sequence[TuningRecording], fit: Fit, found: Sequence[Interval]
) -> tuple[Profile, ...]:
    """Return the objective along each quantity; the others follow it to first order.

    Args:
        recordings: of the fit.
        fit: the fit.
        found: its intervals.
    """
    information = _information(fit)
    models, places = [], []
    low, high = fit.limits
    for place, interval in enumerate(found):
        others = [k for k, one in enumerate(found) if k != place and np.isfinite(one.std)]
        follow = np.zeros(len(found))
        block = information[np.ix_(others, others)] + _VAGUE_INFORMATION * np.eye(len(others))
        follow[others] = -np.linalg.solve(block, information[others, place])
        follow[place] = 1.0
        along = min(interval.std, _WIDEST) * PROFILE_POINTS
        points = np.clip(
            fit.coordinate[:, None] + follow[:, None] * along, low[:, None], high[:, None]
        )
        models.append(with_coordinates(fit.values, fit.which, points))
        places.append(interval.quantity)
    total = fit.weights.each() @ term_values(recordings, np.concatenate(models, axis=1))
    best = float(fit.weights.each() @ fit.slopes.value)
    each = total.reshape(len(found), len(PROFILE_POINTS))
    return tuple(
        Profile(quantity, model[quantity], log_likelihood - best)
        for quantity, model, log_likelihood in zip(places, models, each, strict=True)
    )
