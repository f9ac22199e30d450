# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Row `study`: `study grid` on two cores, beside one."""

import os
import shutil
import subprocess
import sys
import time

from bench.results import Bar, Context, Line, Result, Row, ratio
from bench.workers import environment
from fnn_ekf_ros.errors import FnnEkfError

BAR = Bar(1.7, at_least=True)
"""Bar of the time of one job over that of two."""
JOBS = (1, 2)
"""Numbers of processes that are compared."""
OPTION = "--jobs"
"""Option of `study grid` for the number of processes."""
QUICK_SIZE = ("--runs", "5", "--steps", "50")
"""Size of the study with `--quick`."""

HOW = """
Elapsed time of `study grid`, with the 100 runs of 800 periods that it has if nothing else is said,
by `--jobs 1` and `--jobs 2`, from start to end of the command: recordings, filters, tables and
figures. "Faster" is the time of one job over that of two. Imports and figures are not divided.

Anything else that runs on the machine adds to the elapsed time. The ratio of two cores says
nothing about eight.
"""
"""Text of the row in the document: what is measured, and how."""


def measure(context: Context) -> Result:
    """Measure the row."""
    if OPTION not in _study(context, "--help"):
        return Result(skipped=f"`study grid` has no {OPTION} at this commit")
    if len(os.sched_getaffinity(0)) < max(JOBS):
        return Result(skipped=f"this machine has fewer than {max(JOBS)} cores")
    out = context.build / "grid"
    times: dict[int, list[float]] = {jobs: [] for jobs in JOBS}
    for jobs, values in times.items():
        context.say(f"study: {OPTION} {jobs}")
        shutil.rmtree(out, ignore_errors=True)
        began = time.monotonic()
        size = QUICK_SIZE if context.quick else ()
        _study(context, "--out", str(out), *size, OPTION, str(jobs))
        values.append(time.monotonic() - began)
    one, two = (Line(f"`{OPTION} {jobs}`", "s", values) for jobs, values in times.items())
    return Result([one, two, ratio("two jobs, faster", one, two, BAR)])


def _study(context: Context, *words: str) -> str:
    ran = subprocess.run(
        [sys.executable, "-m", "fnn_ekf_ros", "study", "grid", *words],
        cwd=context.build,
        env=environment(context.root),
        capture_output=True,
        text=True,
        check=False,
    )
    if ran.returncode:
        said = ran.stderr.strip().splitlines()[-1:]
        raise FnnEkfError(f"study grid ended with {ran.returncode}: {' '.join(said)}")
    return ran.stdout


ROW = Row(name="study", title="A study on two cores", how=HOW, measure=measure)
"""Row `study`."""
