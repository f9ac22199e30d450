# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results of `study rates` as Markdown and as rows for JSON."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.evaluation.intervals import Interval, mean_interval, root_ratio_interval
from fnn_ekf_ros.study.rates import (
    CELLS,
    COMMON_S,
    COMPASS_RATE,
    FIX_RATE,
    LARGEST_RATIO,
    NEES_RANGE,
    PERIODS_S,
    SAME_WITHIN,
    PeriodErrors,
    RateCase,
    RateErrors,
)
from fnn_ekf_ros.study.report.tables import (
    command_head,
    or_infinite,
    plain,
    plain_interval,
    start_words,
    table,
)

HOW_TO_READ = """\
Round path, slip of simulation 2; each reading has 0.1 m of noise in x and y of a fix, 0.134 rad in
a yaw. Aligned: readings come at multiples of their intervals; shifted: fixes come 0.3 and the
compass 0.6 of its interval later. Position is the distance in the plane.
"""
"""Explains both tables."""
PERIODS_TO_READ = f"""\
`adaptation: none`, right noise, fixes at {FIX_RATE:g} Hz, compass at {COMPASS_RATE:g} Hz. Errors
are taken every {COMMON_S:g} s, where all periods end. The independent EKF has code of its own,
takes every reading at its instant and knows no periods. Bar: RMSE within {SAME_WITHIN:.0%} of that
at a period of {PERIODS_S[0]:g} s and of the independent EKF's.
"""
"""Explains the table of the periods."""
RATES_TO_READ = f"""\
`adaptation: joint` from the right start and from Q and R each too small or too large by 25 in
variance, last half of the runs. Ratio: RMSE over that of the EKF with the true noise, on
the same readings. NEES: 3 where the covariance is consistent. Each number is the worst of the
{len(CELLS)} starts; the start is that of the worst ratio. Bar: ratios up to {LARGEST_RATIO:g} and
NEES {NEES_RANGE[0]:g} to {NEES_RANGE[1]:g} from every start; rows with `-` are reported only. The
period varies at fixes of {FIX_RATE:g} Hz, the rate of the fixes at a period of 0.375 s.
"""
"""Explains the table of mode joint."""


class PeriodRow(NamedTuple):
    """A period, without adaptation.

    Attributes:
        phases: a name in `PHASES`.
        period_s: of the filter [s].
        seconds: length of the runs [s].
        runs: how many.
        rmse: `(2,)` of position and yaw (m, rad).
        over_first: `(2,)` ratio to the first period.
        plain_rmse: `(2,)` of the independent EKF (m, rad).
        over_plain: `(2,)` ratio to it.
    """

    phases: str
    period_s: float
    seconds: float
    runs: int
    rmse: FloatArray
    over_first: Interval
    plain_rmse: FloatArray
    over_plain: Interval

    @property
    def meets_bar(self) -> bool:
        """Whether it is as good as any other."""
        ratios = np.concatenate([self.over_first.value, self.over_plain.value])
        return bool(np.all(np.abs(ratios - 1.0) <= SAME_WITHIN))


class RateRow(NamedTuple):
    """Joint adaptation in one setting.

    Attributes:
        case: the setting.
        seconds: length of the runs [s].
        runs: how many.
        oracle_rmse: `(2,)` position and yaw of the EKF that knows the noise (m, rad).
        oracle_nees: its NEES.
        ratio: `(2, cells)` RMSE over the oracle's.
        nees: `(cells,)`.
    """

    case: RateCase
    seconds: float
    runs: int
    oracle_rmse: FloatArray
    oracle_nees: float
    ratio: Interval
    nees: Interval

    @property
    def worst_ratio(self) -> FloatArray:
        """Ratios `(2,)` of position and yaw, each from its worst start."""
        return np.asarray(np.max(self.ratio.value, axis=-1))

    @property
    def worst_nees(self) -> float:
        """NEES of the start where it is furthest from 3, as a factor."""
        values = self.nees.value
        return float(values[np.argmax(np.abs(np.log(values / 3.0)))])

    @property
    def meets_bar(self) -> bool:
        """Whether joint adaptation found the noise from all starts."""
        low, high = NEES_RANGE
        nees = self.nees.value
        consistent = bool(np.all((nees >= low) & (nees <= high)))
        return consistent and bool(np.all(self.ratio.value <= LARGEST_RATIO))


def period_rows(phases: str, seconds: float, errors: PeriodErrors) -> list[PeriodRow]:
    """Return the rows of all periods, in the order of `PERIODS_S`."""
    squares = np.stack([errors.position, errors.yaw])
    plain_squares = np.stack([errors.plain_position, errors.plain_yaw])
    return [
        PeriodRow(
            phases=phases,
            period_s=period_s,
            seconds=seconds,
            runs=squares.shape[-1],
            rmse=np.sqrt(np.mean(squares[:, number], axis=-1)),
            over_first=root_ratio_interval(squares[:, number], squares[:, 0]),
            plain_rmse=np.sqrt(np.mean(plain_squares, axis=-1)),
            over_plain=root_ratio_interval(squares[:, number], plain_squares),
        )
        for number, period_s in enumerate(PERIODS_S)
    ]


def rate_row(case: RateCase, seconds: float, runs: int, errors: RateErrors) -> RateRow:
    """Return the row of a setting."""
    squares = np.stack([errors.position, errors.yaw])
    best = np.stack([errors.oracle_position, errors.oracle_yaw])
    return RateRow(
        case=case,
        seconds=seconds,
        runs=runs,
        oracle_rmse=np.sqrt(np.mean(best, axis=-1)),
        oracle_nees=float(np.mean(errors.oracle_nees)),
        ratio=root_ratio_interval(squares, np.broadcast_to(best[:, None], squares.shape)),
        nees=mean_interval(errors.nees),
    )


def period_numbers(row: PeriodRow) -> dict[str, Any]:
    """Return a row for JSON; intervals are [value, low, high]."""
    numbers: dict[str, Any] = {
        "phases": row.phases, "period": row.period_s, "seconds": row.seconds, "runs": row.runs,
    }  # fmt: skip
    for axis, name in enumerate(("position", "yaw")):
        numbers[f"rmse_{name}"] = plain(row.rmse[axis])
        numbers[f"over_first_{name}"] = plain_interval(row.over_first, (axis,))
        numbers[f"independent_rmse_{name}"] = plain(row.plain_rmse[axis])
        numbers[f"over_independent_{name}"] = plain_interval(row.over_plain, (axis,))
    return numbers | {"meets_bar": row.meets_bar}


def rate_numbers(row: RateRow) -> dict[str, Any]:
    """Return a row for JSON, with each of its starts."""
    case = row.case
    return {
        **case.timing._asdict(), "phases": case.phases, "period": case.period_s,
        "seconds": row.seconds, "runs": row.runs,
        "oracle_rmse_position": plain(row.oracle_rmse[0]),
        "oracle_rmse_yaw": plain(row.oracle_rmse[1]),
        "oracle_nees": plain(row.oracle_nees),
        "starts": [
            {
                "q": cell.q, "k": cell.k,
                "ratio_position": plain_interval(row.ratio, (0, index)),
                "ratio_yaw": plain_interval(row.ratio, (1, index)),
                "nees": plain_interval(row.nees, (index,)),
            }
            for index, cell in enumerate(CELLS)
        ],
        "meets_bar": row.meets_bar if case.has_bar else None,
    }  # fmt: skip


def head(made_by: Mapping[str, Any]) -> str:
    """Return the first lines: how the tables were made and how they are read."""
    options = {name: made_by[name] for name in ("runs", "fixes", "seed")}
    return command_head(made_by, options, HOW_TO_READ)


def summary(periods: Sequence[PeriodRow], rates: Sequence[RateRow]) -> str:
    """Return in one sentence how many rows meet their bars."""
    bound = [row for row in rates if row.case.has_bar]
    same = sum(row.meets_bar for row in periods)
    found = sum(row.meets_bar for row in bound)
    return (
        f"The period makes no difference in {same} of {len(periods)} rows; joint adaptation finds "
        f"the noise in {found} of {len(bound)}.\n"
    )


def period_table(rows: Sequence[PeriodRow]) -> str:
    """Return the table of the periods."""
    first = rows[0]
    lines = [
        [
            f"{row.period_s:g}",
            row.phases,
            _pair(row.rmse, 4),
            _pair(row.over_first.value, 3),
            _pair(row.plain_rmse, 4),
            _pair(row.over_plain.value, 3),
            _yes(meets=row.meets_bar),
        ]
        for row in rows
    ]
    columns = [
        "period [s]", "phases", "RMSE, position / yaw [m, rad]", f"over {PERIODS_S[0]:g} s",
        "independent EKF [m, rad]", "over the independent EKF", "meets the bar",
    ]  # fmt: skip
    size = f"{first.runs} runs of {first.seconds:g} s.\n"
    return "\n".join(["## Period, right noise\n", PERIODS_TO_READ, size, table(columns, lines)])


def rate_table(rows: Sequence[RateRow]) -> str:
    """Return the table of joint adaptation."""
    lines = [
        [
            _fixes_words(row.case),
            f"{row.case.timing.compass_rate:g}" if row.case.timing.compass_rate else "none",
            f"{row.case.period_s:g}",
            row.case.phases,
            f"{row.runs} x {row.seconds:g}",
            _pair(row.oracle_rmse, 4),
            _pair(row.worst_ratio, 3),
            _worst_start(row),
            f"{row.worst_nees:.2f}",
            _yes(meets=row.meets_bar) if row.case.has_bar else "-",
        ]
        for row in rows
    ]
    columns = [
        "fixes [Hz]", "compass [Hz]", "period [s]", "phases", "runs x time [s]",
        "oracle, position / yaw [m, rad]", "ratio, position / yaw", "worst start", "NEES",
        "meets the bar",
    ]  # fmt: skip
    return "\n".join(["## Rates and period, joint\n", RATES_TO_READ, table(columns, lines)])


def _fixes_words(case: RateCase) -> str:
    return f"{case.timing.fix_rate:g}{', with yaw' if case.timing.fix_yaw else ''}"


def _worst_start(row: RateRow) -> str:
    worst = [or_infinite(float(value)) for value in np.max(row.ratio.value, axis=0)]
    return start_words(CELLS[int(np.argmax(worst))])


def _pair(values: FloatArray, digits: int) -> str:
    return " / ".join(
        f"{value:.{digits}f}" if np.isfinite(value) else "n/a" for value in values.tolist()
    )


def _yes(*, meets: bool) -> str:
    return "yes" if meets else "**no**"
