# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The objective of tuning: next readings and fixes after simulated outages.

    J(u) = kappa_f l_fix(u) + kappa_c l_compass(u) + w_10 l_10(u) + w_100 l_100(u)

l_fix and l_compass sum the log likelihoods of all readings given those before them. l_H does so for
the fixes after outages of H seconds; the fixes of a window are averaged, so that a window is one
measurement. kappa is how far the next readings are trusted (`fit`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.tuning.forecasts import forecasts
from fnn_ekf_ros.tuning.likelihood import evidence
from fnn_ekf_ros.tuning.likelihood import values as likelihoods
from fnn_ekf_ros.tuning.quantities import STEPS, Quantity, with_coordinates
from fnn_ekf_ros.tuning.recording import HORIZONS_S, TuningRecording

NEXT_FIX, NEXT_COMPASS = range(2)
"""Terms of the next readings."""
OUTAGES = slice(2, 2 + len(HORIZONS_S))
"""Terms of the outages, by horizon."""
TERMS = OUTAGES.stop
"""Terms of the objective."""


class Weights(NamedTuple):
    """Weights of the terms of the objective.

    Attributes:
        next_fix: kappa of the fixes.
        next_compass: kappa of the compass.
        outages: of each horizon's term.
    """

    next_fix: float
    next_compass: float
    outages: tuple[float, ...]

    def each(self) -> FloatArray:
        """Return the weights of all terms, `(4,)`."""
        return np.array([self.next_fix, self.next_compass, *self.outages])


class Timed(NamedTuple):
    """Contributions of a recording's readings to the terms of the objective.

    Attributes:
        time_s: `(K,)` when each reading came [s].
        score: `(4, K, p)` derivatives of the terms.
        value: `(4, K)` the terms [nats].
    """

    time_s: FloatArray
    score: FloatArray
    value: FloatArray


class Slopes(NamedTuple):
    """The terms of the objective at a point, with derivatives.

    Attributes:
        value: `(4,)` the terms [nats].
        gradient: `(4, p)`.
        information: `(4, p, p)` expected curvature.
        timed: contributions of each recording.
    """

    value: FloatArray
    gradient: FloatArray
    information: FloatArray
    timed: tuple[Timed, ...]


def term_values(recordings: Sequence[TuningRecording], models: FloatArray) -> FloatArray:
    """Return the terms of the objective `(4, S)` of models `(16, S)` [nats]."""
    total = np.zeros((TERMS, models.shape[1]))
    for recording in recordings:
        seen = forecasts(recording, models)
        weight = _weights(recording)
        total[NEXT_FIX] += likelihoods(seen.fixes).sum(axis=0)
        total[NEXT_COMPASS] += likelihoods(seen.compass).sum(axis=0)
        for place, items in enumerate(seen.outages):
            total[OUTAGES.start + place] += weight[:, place] @ likelihoods(items)
    return total


def star(base: FloatArray, which: tuple[Quantity, ...], coordinate: FloatArray) -> FloatArray:
    """Return models `(16, 1 + 2p)`: one, and two neighbors for each coordinate."""
    steps = STEPS[list(which)]
    around = np.repeat(coordinate[:, None], 1 + 2 * len(which), axis=1)
    for place, step in enumerate(steps):
        around[place, 1 + 2 * place] += step
        around[place, 2 + 2 * place] -= step
    return with_coordinates(base, which, around)


def slopes(
    recordings: Sequence[TuningRecording],
    base: FloatArray,
    which: tuple[Quantity, ...],
    coordinate: FloatArray,
) -> Slopes:
    """Return the terms at a point and their derivatives.

    Args:
        recordings: that the terms are summed over.
        base: `(16,)` values of what is not searched for.
        which: the p quantities that are.
        coordinate: `(p,)` their coordinates.
    """
    models, steps = star(base, which, coordinate), STEPS[list(which)]
    return combined([slopes_of(recording, models, steps) for recording in recordings])


def slopes_of(recording: TuningRecording, models: FloatArray, steps: FloatArray) -> Slopes:
    """Return the terms of one recording at the center of a star of models."""
    seen = forecasts(recording, models)
    measured = recording.available.any(axis=0)
    ones = np.ones(int(measured.sum()))
    weight = _weights(recording)
    terms = [evidence(items, steps, ones) for items in (seen.fixes, seen.compass)]
    terms += [evidence(items, steps, weight[:, place]) for place, items in enumerate(seen.outages)]
    timed = Timed(
        time_s=np.cumsum(recording.duration_s)[measured],
        score=np.stack([term.score for term in terms]),
        value=np.stack([term.value for term in terms]),
    )
    return Slopes(
        value=timed.value.sum(axis=1),
        gradient=timed.score.sum(axis=1),
        information=np.stack([term.information for term in terms]),
        timed=(timed,),
    )


def combined(each: Sequence[Slopes]) -> Slopes:
    """Return the terms of several recordings together."""
    return Slopes(
        value=np.sum([one.value for one in each], axis=0),
        gradient=np.sum([one.gradient for one in each], axis=0),
        information=np.sum([one.information for one in each], axis=0),
        timed=tuple(timed for one in each for timed in one.timed),
    )


def _weights(recording: TuningRecording) -> FloatArray:
    return recording.schedule.weight[recording.available.any(axis=0)]
