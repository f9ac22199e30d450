# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rows `batch` and `batch_memory`: many robots at once, as the studies run them."""

from bench.places import tree_of
from bench.results import Bar, Context, Line, Result, Row, ratio
from bench.workers import Worker

FILTERS = {"joint": Bar(6.0, at_least=True), "ekf": Bar(4.0, at_least=True), "ekf_gated": None}
"""Bars of the speed over the other commit, by filter; None: shown only."""
SHOWN = {"joint": "`joint`", "ekf": "`none`", "ekf_gated": "`none` with gate"}
"""Names of the filters in the table."""
SIZES = {100: 100, 1000: 20, 10_000: 4}
"""Periods of a batch of so many robots."""
REPEATS = {"joint": 1}
"""Runs of a batch for one number, by filter; the others, which are quick, are run `MANY` times."""
MANY = 5
"""Runs of a batch for one number, but for those in `REPEATS`."""
MEMORY_ROBOTS, MEMORY_STEPS = 10_000, 10
"""Size of the batch whose memory is measured: robots, and periods [375 ms]."""

HOW = """
CPU per robot and step of batches of 100, 1000 and 10 000 robots (fixes and compass measured in
every period), through `study_filters`, the interface that the studies use: `joint`, `none` (the
filter `ekf` of the studies, without a gate) and `none` with the gate (`ekf_gated`). This commit
and the one that it is compared with run in two processes, which take turns batch by batch on the
same arrays; each round has new processes, as the memory that one happens to get makes a
difference of some percent. "Faster" is the other commit's time over this one's. The batches have
100, 20 and 4 periods; making the arrays is not timed.

The numbers say how long a study takes. They hold for batches in which nothing is rejected; a
batch that has a rejected reading in it costs more.
"""
"""Text of row `batch` in the document: what is measured, and how."""
MEMORY_HOW = """
Largest resident memory (VmHWM) of a process that makes a recording of 10 000 robots and 10
periods and runs one filter over it, Python, numpy, recording and track included. Every number is
that of a new process. The part of recording and track grows with the number of periods.
"""
"""Text of row `batch_memory` in the document: what is measured, and how."""


def measure(context: Context) -> Result:
    """Measure the row `batch`."""
    rounds = 2 if context.quick else 5
    batches = [(name, robots) for robots in SIZES for name in FILTERS]
    times: dict[tuple[str, int], list[list[float]]] = {batch: [[], []] for batch in batches}
    with tree_of(context, context.against) as tree:
        for number in range(rounds):
            context.say(f"batch: round {number + 1} of {rounds}")
            with (
                Worker(context, "batch_worker", context.root) as ours,
                Worker(context, "batch_worker", tree) as theirs,
            ):
                for (name, robots), both in times.items():
                    pairs = list(zip((ours, theirs), both, strict=True))
                    # Who begins changes from round to round.
                    for worker, values in pairs if number % 2 == 0 else reversed(pairs):
                        values.append(_time(worker, name, robots))
    lines = []
    for (name, robots), both in times.items():
        what = f"{SHOWN[name]}, {robots} robots"
        now, before = Line(what, "us", both[0]), Line(f"{what}, {context.against}", "us", both[1])
        lines += [now, before, ratio(f"{what}, faster", before, now, FILTERS[name])]
    return Result(lines)


def _time(worker: Worker, name: str, robots: int) -> float:
    """Return the time of a robot and step [us], after a step that is not counted."""
    worker.ask(name=name, robots=robots, steps=1)
    repeats = REPEATS.get(name, MANY)
    found = worker.ask(name=name, robots=robots, steps=SIZES[robots], repeats=repeats)
    return float(found["us"])


def measure_memory(context: Context) -> Result:
    """Measure the row `batch_memory`."""
    lines = []
    with tree_of(context, context.against) as tree:
        for name in FILTERS:
            for suffix, where in {"": context.root, f", {context.against}": tree}.items():
                context.say(f"batch_memory: {SHOWN[name]}{suffix}")
                with Worker(context, "batch_worker", where) as worker:
                    found = worker.ask(name=name, robots=MEMORY_ROBOTS, steps=MEMORY_STEPS)
                lines.append(Line(f"{SHOWN[name]}{suffix}", "MiB", [found["peak_mib"]]))
    return Result(lines)


ROW = Row(name="batch", title="Batches of robots", how=HOW, measure=measure)
"""Row `batch`."""
MEMORY_ROW = Row(
    name="batch_memory", title="Memory of a batch", how=MEMORY_HOW, measure=measure_memory
)
"""Row `batch_memory`."""
