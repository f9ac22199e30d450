# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Row `replay`: an hour of recording through `replay`, beside a copy of the bag."""

from pathlib import Path
from typing import Any

from bench.recording import bag, remove
from bench.results import Bar, Context, Line, Result, Row, ratio
from bench.robot import GEOMETRY
from bench.workers import Worker

BARS = {"joint": Bar(12.0), "none": Bar(8.0)}
"""Bars of the CPU of `replay` over that of a copy, by mode."""
COPY = "copy"
"""Name of the copy in the table."""
HOUR_S, QUARTER_S = 3600, 900
"""Lengths of the recording and of the short one, for memory [s]."""

HOW = """
`replay` of an hour of driving: ticks of each wheel at 50 Hz, a compass at 10 Hz, fixes at 5 Hz,
in mcap with zstd; `scripts/bench/recording.py` makes the same messages each time. Beside it a
copy of the bag by rosbags alone: every message read and the same bytes written, with the same
storage and compression. `replay` does that, too, and reads the messages, filters and writes its
own topics. CPU of `replay` includes its imports, that of the copy does not. Peak memory (VmHWM)
of `replay` over the first quarter of the hour and over the hour is the same if `replay` keeps
nothing.

The ratio says how far `replay` is from the least that a tool on rosbags needs. Most of it is the
cost of a message: 115 come in a second, of which 15 are readings that take a filter step.
"""
"""Text of the row in the document: what is measured, and how."""


def measure(context: Context) -> Result:
    """Measure the row."""
    length_s, short_s = (300, 75) if context.quick else (HOUR_S, QUARTER_S)
    rounds = 1 if context.quick else 2
    whole, quarter = bag(context, length_s), bag(context, short_s)
    cpu: dict[str, list[float]] = {COPY: [], **{mode: [] for mode in BARS}}
    peak: dict[str, list[float]] = {mode: [] for mode in BARS}
    for number in range(rounds):
        for name, values in cpu.items():
            context.say(f"replay: {name}, round {number + 1} of {rounds}")
            found = _once(context, name, whole)
            values.append(found["cpu_s"])
            if name in peak:
                peak[name].append(found["peak_mib"])
    times = {name: Line(f"`{name}`", "s", values) for name, values in cpu.items()}
    times[COPY] = times[COPY]._replace(what="copy of the bag")
    lines = list(times.values())
    lines += [
        ratio(f"`{name}` over copy", times[name], times[COPY], bar) for name, bar in BARS.items()
    ]
    for name in BARS:
        context.say(f"replay: {name}, a quarter")
        short = Line(
            f"`{name}`, peak, a quarter", "MiB", [_once(context, name, quarter)["peak_mib"]]
        )
        lines += [short, Line(f"`{name}`, peak, the whole", "MiB", peak[name])]
    return Result(lines, said=[f"The recording is of {length_s} s, the quarter of {short_s} s."])


def _once(context: Context, name: str, source: Path) -> Any:
    out = context.build / "copied"
    remove(out)
    with Worker(context, "replay_worker", context.root) as worker:
        if name == COPY:
            found = worker.ask(bag=str(source), out=str(out))
        else:
            parameters = {**GEOMETRY, "adaptation": name}
            words = [
                word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")
            ]
            found = worker.ask(command=["replay", str(source), str(out), *words])
    remove(out)
    return found


ROW = Row(name="replay", title="An hour through `replay`", how=HOW, measure=measure)
"""Row `replay`."""
