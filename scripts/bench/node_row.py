# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Row `node`: the live localizer beside a node that does nothing."""

import os
import statistics
import sys
from typing import Any

from child_processes import running_with_log

from bench.results import Bar, Context, Line, Result, Row, ratio
from bench.robot import GEOMETRY
from bench.workers import PATIENCE_S, Worker, environment
from fnn_ekf_ros.errors import FnnEkfError

CPU_BAR, MEMORY_BAR, DELAY_BAR = Bar(1.3), Bar(1.15), Bar(5.0)
"""Bars of the ratios of CPU and of memory, and of the delay's median [ms]."""
LOCALIZER, BARE = "localizer", "bare node"
"""Names of the two nodes in the table."""
SETTLE_S = 6.0
"""Time from the first message to the window that is measured [s]: Python has started by then."""
FEWEST = 0.98
"""Share of the periods that have to have an odom, or the run says nothing."""

HOW = """
The live `localizer` with default parameters (`joint`) beside a bare rclpy node
(`scripts/bench/bare_node.py`) with the same subscriptions and QoS, which publishes one empty
Odometry a period and does nothing with the messages. One process publishes to one of them at a
time, in real time: ticks of each wheel at 50 Hz, a compass at 10 Hz, fixes at 5 Hz, 115 messages
a second; it also subscribes to `odom`. They take turns; each run has new processes, a ROS domain
of its own and discovery on this machine only. CPU and resident memory of the node's process come
from `/proc`, over a window that begins six seconds after the first message: the start of Python
is not in it.

The ratio of CPU says what the package adds to what rclpy takes for receiving. Both nodes are
Python: the ratio says nothing about a node in C++.

A period ends at a multiple of 375 ms. It is closed by the first message of the right wheel after
that: on average half an interval of the ticks later, which no localizer can avoid. The delay is
the time from just before that message is published to the reception of `odom` by the process that
published it (`received_timestamp` of the middleware). It contains two trips between processes, as
the bare node's does, and the work on a compass reading and a fix that were sent just before.
"After the end" is from the end of the period, with the wait for the ticks.
"""
"""Text of the row in the document: what is measured, and how."""


def measure(context: Context) -> Result:
    """Measure the row."""
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        return Result(skipped=f"ROS 2 is not here ({error})")
    window_s, rounds = (12.0, 1) if context.quick else (60.0, 2)
    found: dict[str, list[Any]] = {LOCALIZER: [], BARE: []}
    for number in range(rounds):
        for kind, runs in found.items():
            context.say(f"node: {kind}, {window_s:g} s, round {number + 1} of {rounds}")
            runs.append(_once(context, kind, 1 + (os.getpid() + 2 * number) % 90, window_s))
    counts = "; ".join(
        f"{kind}: {sum(len(run['after_end_ms']) for run in runs)} odom in "
        f"{sum(run['periods'] for run in runs)} periods"
        for kind, runs in found.items()
    )
    said = f"Windows of {window_s:g} s, {counts}. Delays have one median and one 95 % a window."
    return Result([*_costs(found), *_delays(found)], said=[said])


def _costs(found: dict[str, list[Any]]) -> list[Line]:
    cpu, memory = (
        {kind: Line(f"{kind}, {what}", unit, [scale * run[key] for run in runs])
         for kind, runs in found.items()}
        for what, unit, key, scale in (("CPU", "% of a core", "cpu", 100.0),
                                       ("memory", "MiB", "mib", 1.0))
    )  # fmt: skip
    return [
        *cpu.values(),
        ratio("CPU, localizer over bare node", cpu[LOCALIZER], cpu[BARE], CPU_BAR),
        *memory.values(),
        ratio("memory, localizer over bare node", memory[LOCALIZER], memory[BARE], MEMORY_BAR),
    ]


def _delays(found: dict[str, list[Any]]) -> list[Line]:
    lines = []
    for key, what in (("work_ms", "delay"), ("after_end_ms", "after the end")):
        for kind, runs in found.items():
            middle = [statistics.median(run[key]) for run in runs]
            high = [statistics.quantiles(run[key], n=20)[-1] for run in runs]
            bar = DELAY_BAR if (key, kind) == ("work_ms", LOCALIZER) else None
            lines += [
                Line(f"{kind}, {what}, median", "ms", middle, bar),
                Line(f"{kind}, {what}, 95 %", "ms", high),
            ]
    return lines


def _once(context: Context, kind: str, domain: int, window_s: float) -> Any:
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_LOG_DIR"] = str(context.build / "log" / "ros")
    given = [word for key, value in GEOMETRY.items() for word in ("-p", f"{key}:={value}")]
    command = {
        LOCALIZER: ["fnn_ekf_ros", "localizer", "--ros-args", *given],
        BARE: ["bench.bare_node"],
    }[kind]
    with (
        Worker(context, "feed_worker", context.root) as feeder,
        running_with_log(
            context.build / "log" / f"{kind.replace(' ', '_')}.log",
            [sys.executable, "-m", *command],
            PATIENCE_S,
            cwd=context.build,
            env=environment(context.root),
        ) as node,
    ):
        found = feeder.ask(pid=node.pid, settle_s=SETTLE_S, window_s=window_s)
        if node.poll() is not None:
            raise FnnEkfError(f"the {kind} ended with {node.returncode}")
    if len(found["after_end_ms"]) < FEWEST * found["periods"]:
        raise FnnEkfError(
            f"{kind}: {len(found['after_end_ms'])} odom in {found['periods']} periods"
        )
    return found


ROW = Row(
    name="node",
    title="The live node, and from the end of a period to `odom`",
    how=HOW,
    measure=measure,
)
"""Row `node`."""
