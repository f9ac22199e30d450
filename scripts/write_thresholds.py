# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Writes the table of thresholds in docs/diagnostics.md: python3 scripts/write_thresholds.py."""

import argparse
import math
from collections.abc import Sequence
from typing import NamedTuple

from documents import ROOT, read

from fnn_ekf_ros.calibration import (
    block_sums,
    geometry_findings,
    running_examination,
    yaw_blocks,
)
from fnn_ekf_ros.core import frozen, joint, relocation, sensor_lag, suspects
from fnn_ekf_ros.core.lasting import compass_offset, members
from fnn_ekf_ros.core.pace import NOMINAL_PERIOD_S
from fnn_ekf_ros.diagnostics import (
    fault_isolation,
    filter_status,
    recent_periods,
    report,
    stuck_wheel,
    wheel_sizes,
)
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.localizer import localizer
from fnn_ekf_ros.timeline import epochs, events, wheels

DOCUMENT = "docs/diagnostics.md"
BEGIN = "<!-- begin of the table that scripts/write_thresholds.py writes -->\n"
END = "<!-- end of the table -->\n"
S = 1e-9
"""Seconds in a nanosecond."""


class Threshold(NamedTuple):
    """A row of the table.

    Attributes:
        words: what is compared with the value.
        value: from a constant of the package, in `unit`.
        unit: empty for a number or a factor.
    """

    words: str
    value: float
    unit: str = ""


THRESHOLDS = (
    Threshold("silence of a sensor, a wheel or a transform", S * events.STALE_NS, "s"),
    Threshold("stall of readings that are stamped on arrival (ticks), for a jump of a wheel",
              wheels.ARRIVAL_SLACK_S, "s"),
    Threshold("error of a driver's stamps (`joint_states`), for a jump of a wheel",
              wheels.STAMP_SLACK_S, "s"),
    Threshold("silence of a wheel, for a jump to a count near 0", S * wheels.SILENCE_NS, "s"),
    Threshold("stuck wheel: time with a constant count", S * events.STALE_NS, "s"),
    Threshold("stuck wheel: rotation of the robot by the other wheel",
              stuck_wheel.SMALLEST_ROTATION, "rad"),
    Threshold("stuck wheel: difference of the rotations of filter and wheels",
              stuck_wheel.SIGMAS, "standard deviations"),
    Threshold("stuck wheel: the same difference, as a part of the wheels' rotation",
              100 * stuck_wheel.SMALLEST_PART, "%"),
    Threshold("wheel size: time over which corrections are evaluated",
              wheel_sizes.LOOK_BACK_S, "s"),
    Threshold("wheel size: error of a wheel", 100 * wheel_sizes.SMALLEST_PART, "%"),
    Threshold("wheel size: significance of the error", wheel_sizes.SIGMAS, "standard deviations"),
    Threshold("wheel size: significance in each half of the time, and by the rotation alone",
              wheel_sizes.PART_SIGMAS, "standard deviations"),
    Threshold("standing robot: distance in a nominal period", 1e3 * joint.STANDSTILL[0], "mm"),
    Threshold("standing robot: rotation in a nominal period", 1e3 * joint.STANDSTILL[1], "mrad"),
    Threshold("nominal period", 1e3 * NOMINAL_PERIOD_S, "ms"),
    Threshold("frozen sensor: consecutive identical readings", frozen.FROZEN_READINGS),
    Threshold("frozen fixes: jitter that counts as identical", 1e3 * frozen.JITTER, "mm"),
    Threshold("frozen compass: jitter that counts as identical", 1e3 * frozen.JITTER, "mrad"),
    Threshold("frozen fixes: distance by the wheels meanwhile", frozen.FROZEN_DISTANCE, "m"),
    Threshold("frozen compass: rotation by the wheels meanwhile", frozen.FROZEN_ROTATION, "rad"),
    Threshold("readings of one sensor that are used", epochs.MOST_READINGS_A_SECOND, "1/s"),
    Threshold("last readings of a sensor that are evaluated", recent_periods.READINGS),
    Threshold("time between two of them", round(1e-6 * recent_periods.APART_NS), "ms"),
    Threshold("rejected ones among them, for many readings rejected",
              fault_isolation.MANY_REJECTIONS),
    Threshold("scatter: band of the NIS of those readings",
              100 * (1.0 - fault_isolation.BAND_CHANCE), "%"),
    Threshold("scatter: readings between the two times at which it has to show",
              recent_periods.LASTING),
    Threshold("assumed noise of a suspected sensor (std), times the configured one",
              math.sqrt(suspects.SUSPICION)),
    Threshold("suspicion: most that one reading adds", suspects.LARGEST_SUSPECT_GAIN, "nats"),
    Threshold("suspicion: upper limit", suspects.LARGEST_SUSPECT_LEAD, "nats"),
    Threshold("suspicion from which on something is wrong", fault_isolation.SUSPECTED_LEAD,
              "nats"),
    Threshold("distance to the next suspicion, for a sensor to be named",
              fault_isolation.CLEAR_LEAD, "nats"),
    Threshold("time for which that distance lasts", S * recent_periods.LEAD_LASTS_NS, "s"),
    Threshold("suspicion below which a sensor explains nothing", fault_isolation.CLEARED_LEAD,
              "nats"),
    Threshold("rejected fixes that agree, for the wheels not to be named yet",
              fault_isolation.AGREEING),
    Threshold("time for which a wheel's fault, a frozen sensor or late stamps explain the rest",
              S * report.EXPLAINED_NS, "s"),
    Threshold("`joint`: time from the start until suspicion, scatter or wheel sizes name a sensor",
              S * fault_isolation.LEARNING_NS, "s"),
    Threshold("lasting errors: weight from which on they are believed",
              100 * members.LASTING_SHARE, "%"),
    Threshold("yaw that is off: log odds from which on no other sensor is named",
              compass_offset.LIKELY_AT, "nats"),
    Threshold("yaw that is off: log odds from which on it is believed", compass_offset.BELIEVED_AT,
              "nats"),
    Threshold("yaw that is off: time for which they last", compass_offset.BELIEVED_AFTER_S, "s"),
    Threshold("yaw that is off: log odds below which it is given up", compass_offset.GIVEN_UP_AT,
              "nats"),
    Threshold("turned compass: sum of its innovations to one side", compass_offset.TURNED_AT,
              "standard deviations"),
    Threshold("turned compass: time over which it comes about", compass_offset.TURNED_AFTER_S, "s"),
    Threshold("turned compass: log likelihood ratio of the fixes for the wheels meanwhile",
              compass_offset.SUPPORT_NEEDED, "nats"),
    Threshold("late stamps: lag that has to be exceeded significantly", sensor_lag.SMALLEST_LAG,
              "s"),
    Threshold("late stamps: by how much, if many blocks of readings show it",
              sensor_lag.SIGNIFICANT, "standard errors"),
    Threshold("late stamps: effective number of these blocks", sensor_lag.FEWEST_BLOCKS),
    Threshold("late stamps: duration of a block", sensor_lag.BLOCK_S, "s"),
    Threshold("late stamps: readings in a block", sensor_lag.BLOCK_READINGS),
    Threshold("late stamps: largest lag that is reported", sensor_lag.LARGEST_LAG, "s"),
    Threshold("late stamps: memory for the blocks", sensor_lag.LAG_MEMORY_S, "s"),
    Threshold("mistakes: duration of a block", yaw_blocks.BLOCK_S, "s"),
    Threshold("mistakes: blocks of driving from which on one is told",
              running_examination.FEWEST_BLOCKS),
    Threshold("mistakes: blocks that are kept", yaw_blocks.MOST_BLOCKS),
    Threshold("mistakes: newest blocks that can contradict one",
              running_examination.RECENT_BLOCKS),
    Threshold("mistakes: log likelihood that each half of the blocks has to gain by one",
              running_examination.LASTING_GAIN, "nats"),
    Threshold("mistakes: delay that has to be exceeded significantly",
              running_examination.LEAST_TOLD_DELAY_S, "s"),
    Threshold("mistakes: largest delay that is told",
              running_examination.LARGEST_TOLD_DELAY_S, "s"),
    Threshold("mistakes: longest time between two readings of a wheel",
              geometry_findings.SLOWEST_WHEELS_S, "s"),
    Threshold("mistakes: longest time between two readings of a sensor that are compared",
              block_sums.LONGEST_STEP_S, "s"),
    Threshold("degraded: time of driving without an accepted fix or yaw",
              S * filter_status.NOT_CORRECTED_NS, "s"),
    Threshold("lost: standard deviation of the position", filter_status.LOST_POSITION_STD, "m"),
    Threshold("lost: standard deviation of the yaw", filter_status.LOST_YAW_STD, "rad"),
    Threshold("noise at its bound: relative distance to it",
              100 * filter_status.BOUND_TOLERANCE, "%"),
    Threshold("moved pose: consecutive readings that confirm it", relocation.CONFIRMATIONS),
    Threshold("moved pose: time over which they confirm it", relocation.CONFIRMATION_S, "s"),
    Threshold("stamp ahead of the clock, for a message to be dropped",
              S * localizer.LARGEST_LEAD_NS, "s"),
    Threshold("jump of the clock ahead, for a new start", localizer.LONGEST_SILENCE_PERIODS,
              "periods"),
    Threshold("time without any message, for a warning", S * localizer.LONGEST_PAUSE_NS, "s"),
)  # fmt: skip


def table() -> str:
    """Return the table as the document has it, one row a line."""
    rows = [f"| {each.words} | {each.value:.6g} | {each.unit} |" for each in THRESHOLDS]
    lines = ["| threshold | value | unit |", "| --- | --- | --- |", *rows]
    return "".join(line.replace("|  |", "| |") + "\n" for line in lines)


def with_table(text: str) -> str:
    """Return a document's text with the table between its two marks.

    Raises:
        ValueError: it does not have each mark once.
    """
    if (text.count(BEGIN), text.count(END)) != (1, 1):
        raise ValueError(f"{DOCUMENT} has to have '{BEGIN.strip()}' and '{END.strip()}' once")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{table()}\n{END}{after}"


def main(argv: Sequence[str] | None = None) -> None:
    """Rewrite the table."""
    argparse.ArgumentParser(description=__doc__).parse_args(argv)
    write_text(ROOT / DOCUMENT, with_table(read(DOCUMENT)))
    print(DOCUMENT)


if __name__ == "__main__":
    main()
