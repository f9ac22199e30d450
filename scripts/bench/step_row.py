# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Row `step`: one filter step of one robot, beside filterpy's EKF."""

from bench.places import packages
from bench.results import Bar, Context, Line, Result, Row, ratio
from bench.workers import Worker
from fnn_ekf_ros.errors import FnnEkfError

NONE_BAR, JOINT_BAR = Bar(3.0), Bar(9.0)
"""Bars of the CPU of a step over that of filterpy, for modes `none` and `joint`."""
LARGEST_DIFFERENCE = 1e-9
"""Between the means of two implementations of the same filter (m, rad)."""

HOW = """
CPU of one period of one robot in which x, y, compass yaw and the fix's yaw are measured: `none`
(the EKF with its gate) and `joint`, with the localizer's default parameters, beside `predict` and
`update` of filterpy's `ExtendedKalmanFilter` (`scripts/bench/textbook.py`): the same exact arcs,
Jacobians, Q, R and wrapped yaws, scalars by `math`, without a gate, batches, masked rows, limits
or results to look at. All three run in one process on the same data, in blocks that take turns.
The means of `none` and of filterpy's filter are compared at the end of every block; a difference
of more than 1e-9 ends the row.

The ratios say what the package's additions cost where one robot is filtered step by step, as in
the node and in `replay`. A step is due at each time at which something was measured, and at the
end of each period of 375 ms.
"""
"""Text of the row in the document: what is measured, and how."""


def measure(context: Context) -> Result:
    """Measure the row."""
    blocks, steps = (20, 25) if context.quick else (200, 25)
    with Worker(context, "step_worker", context.root, [packages(context)]) as worker:
        found = worker.ask(blocks=blocks, steps=steps)
    if not found["difference"] <= LARGEST_DIFFERENCE:
        raise FnnEkfError(f"step: none and filterpy's EKF differ by {found['difference']:.1e}")
    times = {name: Line(f"`{name}`", "us", values) for name, values in found["us"].items()}
    lines = [
        times["none"],
        times["joint"],
        times["filterpy"]._replace(what="filterpy"),
        ratio("`none` over filterpy", times["none"], times["filterpy"], NONE_BAR),
        ratio("`joint` over filterpy", times["joint"], times["filterpy"], JOINT_BAR),
    ]
    said = (
        f"{blocks} blocks of {steps} steps; `none` and filterpy's filter differ by "
        f"{found['difference']:.0e} at most."
    )
    return Result(lines, said=[said])


ROW = Row(name="step", title="One robot, one step", how=HOW, measure=measure)
"""Row `step`."""
