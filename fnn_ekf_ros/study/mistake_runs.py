# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The runs of `study mistakes`, by several processes, and their tables."""

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from typing import Any, NamedTuple

from fnn_ekf_ros.calibration.examination import Drive, examine
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.study.diagnosed_mistakes import (
    Diagnosed,
    diagnosed,
    examined_numbers,
    fits,
    with_effects,
    with_mistake,
)
from fnn_ekf_ros.study.mistakes import MISTAKES, NOTHING, SLIPS
from fnn_ekf_ros.study.report.tables import table
from fnn_ekf_ros.study.told_mistakes import IN_TIME_S, Told, follow_mistake
from fnn_ekf_ros.study.workers import in_any_order

HOW_TO_READ = f"""\
Each run has one mistake from the start, or none. In time: within {IN_TIME_S:g} s of driving the
status of the sensor tells it, with the parameter and the value to set, in each report to the end.
After: seconds until then, in each run; - where it is not told. Others: sensors that are not OK
after it is told. Wrong: other mistakes that are told at any time.

The second table is of `doctor`, for the same drives. Named: a finding above possible has one of the
right parameters, or is the right one where no parameter puts it right. Off: the median and the
largest error of the value to set, relative to the value for sizes and units, to the mistake for
angles and delays. Covered: the 95 % interval has the right value in it. Others: further findings
above possible.
"""
"""Explains the tables."""
HOW_TO_READ_RECORDINGS = """\
Each mistake is put into the readings of a recording, or into its configuration, and `doctor` is
asked. Named: a finding above possible has one of the right parameters, or is the right one where no
parameter puts it right. Off: the error of the value to set against the one that `doctor` finds in
the recording as it is, relative to the value for sizes and units, to the mistake for angles and
delays. Others: findings above possible that the recording as it is does not have.
"""
"""Explains the table of recordings."""


CLOSE = 0.05
"""Error of a value in a recording up to which it is close."""


class MistakePlan(NamedTuple):
    """Plan of `study mistakes`.

    Attributes:
        names: of the mistakes, and `NOTHING`.
        runs: of each mistake and slip.
        seconds: length of each run [s].
        path: what is driven.
        seed: of the first run.
        given: parameters of the localizer that the user chose.
    """

    names: Sequence[str]
    runs: int
    seconds: float
    path: str
    seed: int
    given: dict[str, Any]


class _Run(NamedTuple):
    """A run: its mistake, its slip and its seed."""

    name: str
    slip: str
    seed: int


class _Runner:
    """Runs robots with mistakes, in any process."""

    def __init__(self, path: str, seconds: float, given: dict[str, Any]) -> None:
        self._path, self._seconds, self._given = path, seconds, given

    def __call__(self, run: _Run) -> Told:
        """Return what diagnostics say."""
        robot = FakeRobotParameters(path=self._path, seed=run.seed, slip_std=SLIPS[run.slip])
        return follow_mistake(run.name, run.slip, robot, self._seconds, self._given)


def run_mistakes(plan: MistakePlan, jobs: int) -> list[Told]:
    """Run robots with mistakes.

    Args:
        plan: the runs.
        jobs: processes.

    Raises:
        WorkError: a run failed, or a process has ended.
    """
    runs = [
        _Run(name, slip, plan.seed + number)
        for name in plan.names
        for slip in SLIPS
        for number in range(plan.runs)
    ]
    requests = [(f"{run.name}, slip {run.slip}, seed {run.seed}", run) for run in runs]
    work = in_any_order(jobs, _Runner, requests, plan.path, plan.seconds, plan.given)
    with closing(work):
        done = dict(with_progress(work, len(requests), "study mistakes"))
    return [done[number] for number in range(len(requests))]


def mistake_table(names: Sequence[str], told: Sequence[Told]) -> str:
    """Return the results in Markdown."""
    about = {mistake.name: mistake.about for mistake in MISTAKES}
    lines = []
    for name in names:
        for slip in SLIPS:
            own = [each for each in told if each.mistake == name and each.slip == slip]
            after = ["-" if math.isnan(e.named_s) else f"{e.named_s:.0f}" for e in own]
            lines.append(
                [
                    name,
                    about.get(name, "as configured"),
                    slip,
                    "n/a" if name == NOTHING else f"{sum(e.in_time for e in own)} of {len(own)}",
                    ", ".join(after),
                    own[0].value if own else "",
                    ", ".join(sorted({other for each in own for other in each.others})) or "-",
                    "; ".join(dict.fromkeys(said for each in own for said in each.wrong)) or "-",
                    f"{sum(e.warned for e in own) / max(sum(e.reports for e in own), 1):.1%}",
                ]
            )
    return table(
        ["mistake", "what it is", "slip", "in time", "after [s]", "value told, first run", "others",
         "wrong", "WARN or worse"],
        lines,
    )  # fmt: skip


def doctor_table(names: Sequence[str], told: Sequence[Told]) -> str:
    """Return what `doctor` says of the same drives in Markdown."""
    lines = []
    for name in names:
        for slip in SLIPS:
            own = [e.doctor for e in told if e.mistake == name and e.slip == slip]
            lines.append([name, slip, *_doctor_cells(own, name)])
    return table(["mistake", "slip", "named", "off", "covered", "others"], lines)


def _doctor_cells(found: Sequence[Diagnosed], name: str) -> list[str]:
    errors = [abs(each.error) for each in found if not math.isnan(each.error)]
    covered = [each.covered for each in found if each.covered is not None]
    named = f"{sum(bool(each.certainty) for each in found)} of {len(found)}"
    return [
        "n/a" if name == NOTHING else named,
        f"{statistics.median(errors):.1%}, {max(errors):.1%}" if errors else "-",
        f"{sum(covered)} of {len(covered)}" if covered else "-",
        ", ".join(sorted({other for each in found for other in each.others})) or "-",
    ]


def summary(told: Sequence[Told]) -> str:
    """Return in one line how many were named in time."""
    wrong = [each for each in told if each.mistake != NOTHING]
    nothing = [each for each in told if each.mistake == NOTHING]
    parts = [f"{sum(each.in_time for each in wrong)} of {len(wrong)} mistakes told in time"]
    parts.append(f"{sum(bool(each.wrong) for each in wrong)} runs with another one")
    doctor = [each.doctor for each in wrong]
    parts.append(f"{sum(bool(each.certainty) for each in doctor)} named by doctor")
    parts.append(f"{sum(bool(each.doctor.others) for each in told)} drives with another finding")
    if nothing:
        said = sum(bool(each.wrong) for each in nothing)
        parts.append(f"without a mistake {said} of {len(nothing)} runs with one told")
    return ", ".join(parts)


class Recorded(NamedTuple):
    """A mistake that was put into a recording.

    Attributes:
        bag: name of the recording.
        mistake: its name.
        doctor: what is found.
    """

    bag: str
    mistake: str
    doctor: Diagnosed


def diagnose_recording(
    name: str, drive: Drive, configured: Mapping[str, Any], names: Sequence[str]
) -> Iterator[Recorded]:
    """Put one mistake after the other into a recording and yield what `doctor` says.

    Args:
        name: of the recording.
        drive: its readings.
        configured: parameters of the localizer, by name.
        names: of the mistakes; those about a sensor that is not there are passed over.
    """
    known = {finding.name for finding in examine(drive, configured).findings}
    numbers = examined_numbers(drive, configured)
    for mistake in MISTAKES:
        if mistake.name in names and fits(mistake, drive):
            found = diagnosed(
                mistake,
                with_mistake(drive, mistake),
                mistake.configured(configured),
                with_effects(numbers, mistake),
                known,
            )
            yield Recorded(name, mistake.name, found)


def recorded_table(found: Sequence[Recorded]) -> str:
    """Return what `doctor` says of recordings with mistakes in Markdown."""
    about = {mistake.name: mistake.about for mistake in MISTAKES}
    lines = [
        [
            each.bag,
            each.mistake,
            about[each.mistake],
            each.doctor.certainty or "**no**",
            "-" if math.isnan(each.doctor.error) else f"{each.doctor.error:+.1%}",
            ", ".join(each.doctor.others) or "-",
        ]
        for each in found
    ]
    return table(["recording", "mistake", "what it is", "named", "off", "others"], lines)


def recorded_summary(found: Sequence[Recorded]) -> str:
    """Return in one line how many mistakes were named."""
    named = sum(bool(each.doctor.certainty) for each in found)
    errors = [abs(each.doctor.error) for each in found if not math.isnan(each.doctor.error)]
    close = sum(error <= CLOSE for error in errors)
    return (
        f"{named} of {len(found)} mistakes named by doctor, {close} of {len(errors)} values within "
        f"{CLOSE:.0%}, {sum(bool(each.doctor.others) for each in found)} with another finding"
    )
