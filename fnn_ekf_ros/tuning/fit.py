# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The fits: errors taken for white, errors that last, and which of them the recordings show.

The likelihood of next readings is the sharpest measure there is, if the model of the errors is
right. If it is not, it takes an error of the fixes that lasts for precise fixes and bad wheels, and
forecasts over outages fail. So each model is fitted twice:

    cautious    outages decide; next readings settle what outages do not see, with a small kappa
    full        next readings alone

and the full fit counts if it forecasts over outages nearly as well as the cautious one does.

An outage tells how well the pose is known only if it outlasts the errors of the fixes: before and
after a shorter one the fixes err alike, and a filter that follows their errors predicts them best.
If the time constant that short outages find is too long for them, long ones decide.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.tuning.objective import TERMS, Slopes, Weights, slopes, term_values
from fnn_ekf_ros.tuning.quantities import (
    LASTING,
    Quantity,
    bounds,
    coordinates,
    with_coordinates,
)
from fnn_ekf_ros.tuning.recording import STANDSTILL, TuningRecording
from fnn_ekf_ros.tuning.search import Limits, Point, maximize

SHORT_OUTAGES = Weights(next_fix=0.015, next_compass=0.015, outages=(1.0, 1.0))
"""Weights of the cautious fit, for errors of seconds: a window of 5 s counts as much as 70
readings, so that next readings decide only what outages do not see."""
LONG_OUTAGES = Weights(next_fix=0.0005, next_compass=0.015, outages=(0.0, 1.0))
"""The same for errors of tens of seconds, by windows of 50 s. The compass keeps its weight: its
readings are not misled by errors of the fixes."""
FULL = Weights(next_fix=1.0, next_compass=1.0, outages=(0.0, 0.0))
"""Weights of the fit that trusts next readings."""
ERROR_TIME_S = {SHORT_OUTAGES: 5.0, LONG_OUTAGES: 50.0}
"""Largest time constant of fix errors that cautious fits may find [s]: after an outage twice as
long, 13 % of an error is left."""
LONG_WINDOWS = 30
"""Fewest windows of long outages by which a model is fitted: with fewer, chance decides."""
LARGEST_DISTANCE_NOISE = 2.0
"""Largest noise of the wheels' distance, over the distance that they usually drive in a nominal
period: what is larger is no noise of theirs, but an error of the fixes that the model lacks."""
ALLOWED_LOSS = 0.75
"""Largest loss of log likelihood of outages by the full fit, per quantity that is fitted [nats];
where the model is right, four quantities lose 0.3 to 1.8."""
GIVEN_UP = 3.0
"""Multiple of `ALLOWED_LOSS` from which on a full fit is not finished."""
LASTING_GAIN = 3.0
"""Gain of the cautious objective from which on errors are said to last [nats]: the model has four
more quantities."""
LASTING_GAIN_FULL = 8.0
"""The same where next readings are trusted with both models [nats]."""
FIX_FACTORS = (1.0, 3.0, 10.0)
"""Lasting fix errors to begin with, over the white noise to begin with."""
WHITE_PARTS = (0.3, 1.0)
"""White noise of the fixes to begin with, over that of the white model."""
FIX_TIMES_S = (4.0, 15.0, 60.0)
"""Time constants of fix errors to begin with [s]."""
YAW_ERRORS = (0.03, 0.15)
"""Lasting yaw errors to begin with [rad]."""
YAW_TIME_S = 15.0
"""Time constant of yaw errors to begin with [s]."""
YAW_CONSTANT_STD = 0.1
"""Standard deviation of a constant yaw error where no offset is looked for [rad]: what a compass in
a building is off by, and what `compass_offset` does not say."""
_AT_A_TIME = 36
"""Models that are computed together: arrays of more do not stay in the processor's cache."""

Progress = Callable[[str], None]
"""Is told what is being done."""


class Fit(NamedTuple):
    """A fitted model.

    Attributes:
        which: the p quantities that were fitted.
        values: `(16,)` of all quantities.
        coordinate: `(p,)`.
        slopes: of the terms of the objective there.
        limits: of the coordinates.
        weights: of the terms.
        cautious: weights of the cautious fit.
        cautious_terms: `(4,)` the terms at the optimum of the cautious fit [nats].
        outage_loss: what the full fit loses by outages [nats].
    """

    which: tuple[Quantity, ...]
    values: FloatArray
    coordinate: FloatArray
    slopes: Slopes
    limits: Limits
    weights: Weights
    cautious: Weights
    cautious_terms: FloatArray
    outage_loss: float

    @property
    def trusts_next_readings(self) -> bool:
        """Whether the full fit counts."""
        return self.weights == FULL


class _Optimum(NamedTuple):
    coordinate: FloatArray
    slopes: Slopes
    converged: bool


class _Search:
    """Fits of one model.

    Args:
        recordings: to fit it to.
        which: the quantities to fit.
        base: `(16,)` values of the others.
        progress: is told about each pass.
    """

    def __init__(
        self,
        recordings: Sequence[TuningRecording],
        which: tuple[Quantity, ...],
        base: FloatArray,
        progress: Progress,
    ) -> None:
        self._recordings, self._which, self._base = recordings, which, base
        self._progress = progress

    def limits(self, weights: Weights) -> Limits:
        """Return the smallest and the largest coordinates of a search."""
        low, high = bounds(self._which)
        usual = max(map(_usual_distance, self._recordings))
        largest = {Quantity.DISTANCE: LARGEST_DISTANCE_NOISE * usual}
        if weights in ERROR_TIME_S:
            largest[Quantity.FIX_TIME] = ERROR_TIME_S[weights]
        for place, quantity in enumerate(self._which):
            if quantity in largest:
                high[place] = min(high[place], np.log(largest[quantity]))
        return low, high

    def best(
        self,
        weights: Weights,
        begin: FloatArray,
        gives_up: Callable[[Slopes], bool] = lambda _: False,
    ) -> _Optimum:
        """Return the optimum from coordinates `(p,)`."""
        each, seen = weights.each(), {}

        def at(u: FloatArray) -> Point:
            self._progress("next readings" if weights == FULL else "outages")
            there = slopes(self._recordings, self._base, self._which, u)
            seen[u.tobytes()] = there
            return Point(
                value=float(each @ there.value),
                gradient=each @ there.gradient,
                information=np.einsum("t,tij->ij", each, there.information),
            )

        def given_up(u: FloatArray) -> bool:
            return gives_up(seen[u.tobytes()])

        found, _, converged = maximize(at, self.limits(weights), begin, given_up)
        return _Optimum(found, seen[found.tobytes()], converged)


def fit(
    recordings: Sequence[TuningRecording],
    which: tuple[Quantity, ...],
    begin: FloatArray,
    progress: Progress,
) -> Fit:
    """Return the fit of a model.

    Args:
        recordings: to fit it to.
        which: the p quantities to fit.
        begin: `(16, S)` values to begin with, of which the best are taken, and of the others.
        progress: is told about each pass.
    """
    terms = _terms(recordings, begin)
    best = begin[:, int(np.nanargmax(SHORT_OUTAGES.each() @ terms))]
    search, weights = _Search(recordings, which, best, progress), SHORT_OUTAGES
    cautious = search.best(weights, coordinates(best, which))
    if _needs_long_outages(recordings, which, cautious.coordinate):
        best = begin[:, int(np.nanargmax(LONG_OUTAGES.each() @ terms))]
        search, weights = _Search(recordings, which, best, progress), LONG_OUTAGES
        cautious = search.best(weights, coordinates(best, which))
    outages = np.array([0.0, 0.0, *weights.outages])
    most = float(outages @ cautious.slopes.value)
    allowed = ALLOWED_LOSS * len(which)
    full = search.best(
        FULL, cautious.coordinate,
        lambda there: most - float(outages @ there.value) > GIVEN_UP * allowed,
    )  # fmt: skip
    loss = most - float(outages @ full.slopes.value)
    counts_in_full = full.converged and loss <= allowed
    optimum, counts = (full, FULL) if counts_in_full else (cautious, weights)
    return Fit(
        which=which,
        values=with_coordinates(best, which, optimum.coordinate[:, None])[:, 0],
        coordinate=optimum.coordinate,
        slopes=optimum.slopes,
        limits=search.limits(counts),
        weights=counts,
        cautious=weights,
        cautious_terms=cautious.slopes.value,
        outage_loss=loss,
    )


def _usual_distance(recording: TuningRecording) -> float:
    """Return the distance of a nominal period while the robot moves, at least a millimeter [m]."""
    distance, duration_s = np.abs(recording.control[0]), recording.duration_s
    moves = distance > STANDSTILL[0] * duration_s
    if not moves.any():
        return 1e-3
    speed = float(distance[moves].sum() / duration_s[moves].sum())
    return max(1e-3, speed * NOMINAL_PERIOD_S)


def _terms(recordings: Sequence[TuningRecording], models: FloatArray) -> FloatArray:
    """Return the terms of the objective `(4, S)` of models `(16, S)`."""
    if models.shape[1] == 1:
        return np.zeros((TERMS, 1))
    parts = range(0, models.shape[1], _AT_A_TIME)
    each = [term_values(recordings, models[:, k : k + _AT_A_TIME]) for k in parts]
    return np.concatenate(each, axis=1)


def _needs_long_outages(
    recordings: Sequence[TuningRecording], which: tuple[Quantity, ...], coordinate: FloatArray
) -> bool:
    """Return whether short outages do not outlast the errors, and there are enough long ones."""
    if Quantity.FIX_TIME not in which:
        return False
    longest = np.log(ERROR_TIME_S[SHORT_OUTAGES])
    windows = sum(float(recording.schedule.weight[:, -1].sum()) for recording in recordings)
    at_bound = coordinate[which.index(Quantity.FIX_TIME)] >= longest
    return bool(at_bound) and windows >= LONG_WINDOWS


def beginnings(values: FloatArray, *, constant_yaw_error: bool) -> FloatArray:
    """Return values `(16, S)` of models whose errors last, to begin a fit with.

    Args:
        values: `(16,)` of a model whose errors are white.
        constant_yaw_error: whether yaws may be off by a constant that is not looked for.
    """
    found = []
    for part in WHITE_PARTS:
        for factor in FIX_FACTORS:
            for time_s in FIX_TIMES_S:
                for yaw in YAW_ERRORS:
                    one = values.copy()
                    one[Quantity.POSITION] *= part
                    error = factor * one[Quantity.POSITION]
                    one[list(LASTING)] = error, time_s, yaw, YAW_TIME_S
                    one[Quantity.YAW_CONSTANT] = YAW_CONSTANT_STD if constant_yaw_error else 0.0
                    found.append(one)
    return np.stack(found, axis=1)


def errors_last(white: Fit, lasting: Fit) -> bool:
    """Return whether the recordings show errors that last."""
    if lasting.trusts_next_readings and white.trusts_next_readings:
        gain = lasting.slopes.value - white.slopes.value
        return float(FULL.each() @ gain) > LASTING_GAIN_FULL
    if lasting.trusts_next_readings:
        return True
    gain = lasting.cautious_terms - white.cautious_terms
    return float(lasting.cautious.each() @ gain) > LASTING_GAIN
