# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Runs side by side: which is better by what, and where the data cannot tell.

Two runs of the same recording see the same fixes at the same time, so that their errors are
compared pair by pair: what both have in common cancels. The mean difference of squared errors is
judged beside its standard error, which counts only as many pairs as are independent
(`independent_values`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.evaluation.alignment import aligned_track
from fnn_ekf_ros.evaluation.consistency import Verdict, independent_values
from fnn_ekf_ros.evaluation.evaluation import Evaluation
from fnn_ekf_ros.evaluation.intervals import student_t
from fnn_ekf_ros.evaluation.motion import OUTAGES_S, forecasts
from fnn_ekf_ros.recordings.run_record import RunRecord
from fnn_ekf_ros.timeline.trajectory import Trajectory

FEWEST_PAIRS = 8.0
"""Fewest independent pairs from which runs are told apart: fewer differ by chance."""
MOST_PAIRS = 4000
"""Largest number of pairs that are compared; more of them are thinned out evenly."""


class Series(NamedTuple):
    """Errors of a run over time, which are compared with another run's.

    Attributes:
        time_ns: `(n,)` [ns].
        error: `(n,)` their sizes; NaN where not known.
        power: 2: their root mean square is compared; 1: their mean, which single wild fixes do not
            decide.
    """

    time_ns: NDArray[np.int64]
    error: FloatArray
    power: int = 2

    def size(self) -> float:
        """Return the mean of the errors' powers, as an error; NaN where nothing is known."""
        known = self.error[np.isfinite(self.error)]
        return float(np.mean(known**self.power)) ** (1.0 / self.power) if len(known) else math.nan


class Measure(NamedTuple):
    """Something that is compared by its errors, smaller is better.

    Attributes:
        name: in a few words.
        unit: of the errors.
        series: of each run, by its name.
    """

    name: str
    unit: str
    series: dict[str, Series]


class Difference(NamedTuple):
    """How two runs compare by a measure.

    Attributes:
        ratio: size of the errors of the one over that of the other's.
        low: lower end of the 95 % interval of the ratio.
        high: its upper end.
        pairs: number of independent pairs.
    """

    ratio: float
    low: float
    high: float
    pairs: float

    @property
    def told_apart(self) -> bool:
        """Whether the data tells them apart."""
        return self.pairs >= FEWEST_PAIRS and not self.low <= 1.0 <= self.high


class Judgment(NamedTuple):
    """The best run by a measure.

    Attributes:
        name: of the measure.
        unit: of the errors.
        best: the run with the smallest ones.
        size: of its errors.
        others: how the other runs compare with it.
    """

    name: str
    unit: str
    best: str
    size: float
    others: dict[str, Difference]


class Compared(NamedTuple):
    """A run with all that is compared of it.

    Attributes:
        run: what its localizer published.
        truth: the ground truth; None without one.
        found: its evaluation.
    """

    run: RunRecord
    truth: Trajectory | None
    found: Evaluation


def measures(runs: Mapping[str, Compared]) -> list[Measure]:
    """Return what the runs are compared by: errors with truth, and forecasts without."""
    found = []
    if all(each.found.truth is not None for each in runs.values()):
        found += _truth_measures(runs)
    found += [
        Measure(
            f"mean forecast of fixes {gap_s:.0f} s ahead", "m",
            {name: _forecast_of_fixes(each, gap_s) for name, each in runs.items()},
        )
        for gap_s in OUTAGES_S
    ]  # fmt: skip
    return [
        each for each in found
        if all(np.any(np.isfinite(series.error)) for series in each.series.values())
    ]  # fmt: skip


def difference(one: Series, other: Series) -> Difference:
    """Return how the errors of one run compare with those of another at the same times.

    By the delta method on the logarithm: with d = a / mean a - b / mean b of the powers a and b of
    the errors, the standard error of log(mean a / mean b) is that of the mean of d.
    """
    common, mine, others = np.intersect1d(one.time_ns, other.time_ns, return_indices=True)
    power = one.power
    a, b = one.error[mine] ** power, other.error[others] ** power
    known = np.isfinite(a) & np.isfinite(b)
    a, b = a[known], b[known]
    if len(a) < 2 or not np.mean(a) > 0.0 or not np.mean(b) > 0.0:
        same = 1.0 if len(common) and np.array_equal(a, b) else math.nan
        return Difference(same, 0.0, math.inf, 0.0)
    d = a / np.mean(a) - b / np.mean(b)
    pairs = independent_values(d)
    ratio = float(np.mean(a) / np.mean(b)) ** (1.0 / power)
    half = student_t(max(int(pairs) - 1, 1)) * float(np.std(d)) / math.sqrt(pairs) / power
    factor = math.exp(min(half, 50.0))
    return Difference(ratio, ratio / factor, ratio * factor, pairs)


def judge(measure: Measure) -> Judgment:
    """Find the run that is best by a measure, and from which the data tells it apart."""
    sizes = {name: series.size() for name, series in measure.series.items()}
    best = min(sizes, key=lambda name: sizes[name])
    others = {
        name: difference(series, measure.series[best])
        for name, series in measure.series.items()
        if name != best
    }
    return Judgment(measure.name, measure.unit, best, sizes[best], others)


def judgment_in_words(found: Judgment) -> str:
    """Say which run is best by a measure, and from which the data cannot tell it."""
    apart, alike, unknown = [], [], []
    for name, each in found.others.items():
        span = f"{each.low:.2f} to {min(each.high, 99.0):.2f}"
        if not each.pairs > 0.0 and math.isnan(each.ratio):
            unknown.append(name)
        elif each.told_apart:
            apart.append(f"{name} {each.ratio:.2f} times as large ({span})")
        else:
            alike.append(f"{name} ({each.ratio:.2f}, {span})")
    parts = []
    if apart:
        parts.append(f"{found.best} is best, {found.size:.3g} {found.unit}")
        parts.append(", ".join(apart))
    if alike:
        parts.append(f"the data cannot tell {found.best} from {', '.join(alike)}")
    if unknown:
        parts.append(f"{found.best} and {', '.join(unknown)} have no times in common")
    return f"{found.name}: {'; '.join(parts)}"


def conclusion(found: Sequence[Judgment]) -> str:
    """Say in one line by what each run is better than all others, and where none is."""
    best: dict[str, list[str]] = {}
    nowhere = []
    for each in found:
        if each.others and all(other.told_apart for other in each.others.values()):
            best.setdefault(each.best, []).append(each.name)
        else:
            nowhere.append(each.name)
    parts = [f"{name} is best by {', '.join(names)}" for name, names in best.items()]
    if nowhere:
        parts.append(f"no run is told from all others by {', '.join(nowhere)}")
    return f"in all: {'; '.join(parts) or 'there is nothing to compare by'}"


def judge_consistency(runs: Mapping[str, Compared]) -> list[str]:
    """Say which runs are honest by NEES and NIS, and whose innovations are nearest to white."""
    said = []
    nees = {name: each.found.truth.nees for name, each in runs.items() if each.found.truth}
    nis = {name: each.found.nis for name, each in runs.items()}
    for word, found in (("NEES", nees), ("NIS", nis)):
        known = {name: each for name, each in found.items() if each.size}
        if len(known) < len(runs):
            continue
        honest = [name for name, each in known.items() if each.verdict is Verdict.HONEST]
        if len(honest) == len(runs):
            said.append(f"{word}: all are honest")
        elif honest:
            others = [name for name in known if name not in honest]
            said.append(f"{word}: {_listed(honest)} honest, {_listed(others)} not")
        else:
            nearest = min(known, key=lambda name: abs(math.log(max(known[name].ratio, 1e-300))))
            said.append(f"{word}: none is honest, {nearest} is nearest to it")
    sensors = list(dict.fromkeys(name for each in runs.values() for name in each.found.sensors))
    said += [
        _judge_whiteness(sensor, runs) for sensor in sensors
        if all(sensor in each.found.sensors for each in runs.values())
    ]  # fmt: skip
    return said


def _judge_whiteness(sensor: str, runs: Mapping[str, Compared]) -> str:
    found = {name: each.found.sensors[sensor].whiteness for name, each in runs.items()}
    best = min(found, key=lambda name: abs(found[name].lag_one))
    apart = [
        name for name, each in found.items()
        if abs(each.lag_one) - abs(found[best].lag_one) > math.hypot(each.band, found[best].band)
    ]  # fmt: skip
    if not apart:
        return f"whiteness of {sensor}: the data cannot tell the runs apart"
    return f"whiteness of {sensor}: {best} is nearer to white than {', '.join(apart)}"


def _truth_measures(runs: Mapping[str, Compared]) -> list[Measure]:
    position, yaw = {}, {}
    for name, each in runs.items():
        assert each.found.truth is not None
        matched = each.found.truth.matched
        e = matched.errors()
        position[name] = Series(matched.time_ns, np.hypot(e[:, 0], e[:, 1]))
        yaw[name] = Series(matched.time_ns, np.abs(e[:, 2]))
    found = [Measure("position error", "m", position), Measure("yaw error", "rad", yaw)]
    found += [
        Measure(
            f"forecast of truth {gap_s:.0f} s ahead", "m",
            {name: _forecast_of_truth(each, gap_s) for name, each in runs.items()},
        )
        for gap_s in OUTAGES_S
    ]  # fmt: skip
    return found


def _forecast_of_truth(each: Compared, gap_s: float) -> Series:
    assert each.found.truth is not None
    matched = each.found.truth.matched
    kept = _thinned(len(matched.time_ns))
    run = replace(each.run, track=aligned_track(each.run.track, each.found.truth.motion))
    found = forecasts(run, matched.time_ns[kept], matched.truth[kept, :2], gap_s)
    return Series(found.time_ns, found.error)


def _forecast_of_fixes(each: Compared, gap_s: float) -> Series:
    """Score by the fixes of the run."""
    fixes = each.run.fixes
    if fixes is None:
        return Series(np.zeros(0, dtype=np.int64), np.zeros(0))
    time_ns, first = np.unique(fixes.time_ns, return_index=True)
    kept = _thinned(len(time_ns))
    found = forecasts(each.run, time_ns[kept], fixes.pose[first[kept], :2], gap_s)
    return Series(found.time_ns, found.error, power=1)


def _thinned(n: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, max(n - 1, 0), min(n, MOST_PAIRS)).astype(np.intp))


def _listed(names: Sequence[str]) -> str:
    verb = "is" if len(names) == 1 else "are"
    return f"{', '.join(names)} {verb}"
