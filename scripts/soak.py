# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Ten simulated days in one run of the localizer: does anything grow, drift or break?

A robot drives figures of eight, with a rest now and then; its wheels slip, its sensors are noisy,
its counters wrap, and once an hour something goes wrong: an outlier, a compass that is silent, a
robot that is carried. Every period is checked: the next multiple of the period, finite, positive
definite. Prints a line a simulated day; ends with exit code 1 at the first thing that is wrong.
"""

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.motion import MotionModel, displacement
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.paper import MEASUREMENT_STD, SIMULATION_2_STD
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.timeline.events import (
    CompassYaw,
    Estimate,
    Event,
    Output,
    PoseFix,
    Wheel,
    WheelCount,
)
from fnn_ekf_ros.timeline.filter_model import wheel_geometry

SPEED, LAP_S, REST_S = 0.3, 40.0, 20.0
"""Speed, duration of a lap, and of the rest after two laps, one to each side (m/s, s, s)."""
HOUR, DAY = 9600, 230400
"""Lengths of an hour and a day [periods of 375 ms]."""
OUTLIER_AT, SILENT_AT, CARRIED_AT = 2000, 4000, 6000
"""Times in each hour of the outlier, the silent compass and the carried robot [periods]."""
SILENCE = 40
"""Duration of the compass's silence [periods]."""
TROUBLED = 60
"""Time after each of these that is not scored [periods]: the filter needs it to settle."""
LARGEST_ERROR = 2.0
"""Largest error of a scored position [m]: twenty standard deviations of a fix."""
MOST_GROWTH_MB = 4.0
"""Largest growth of memory after the first day [MB], checked once an hour."""
PARAMETERS = LocalizerParameters(
    wheel_radius=0.025,
    wheel_separation=0.6,
    encoder_counts_per_revolution=500.0,
    encoder_bits=16,
)
"""Parameters of the localizer; encoder counters of 16 bits wrap often."""
PERIOD_NS = round(PARAMETERS.period * 1e9)
"""The filter's period [ns]."""


class Robot:
    """The simulated robot, a period at a time."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._meters_per_count = wheel_geometry(PARAMETERS).meters_per_count
        self._travel = np.zeros(2)
        self.pose = np.zeros(3)

    def move(self, period: int) -> None:
        """Drive, or rest, for a period."""
        at = period * PARAMETERS.period % (2.0 * LAP_S + REST_S)
        if at >= 2.0 * LAP_S:
            return
        turn = 2.0 * math.pi / LAP_S * (1.0 if at < LAP_S else -1.0)
        control = np.array([SPEED, turn]) * PARAMETERS.period
        half = 0.5 * PARAMETERS.wheel_separation * control[1]
        self._travel = self._travel + np.array([control[0] - half, control[0] + half])
        slip = np.asarray(SIMULATION_2_STD) * self._rng.standard_normal(2)
        self.pose = self.pose + displacement(
            MotionModel(PARAMETERS.motion_model), self.pose[2], control + slip
        )
        self.pose[2] = wrap_angle(self.pose[2])

    def events(self, period: int) -> list[Event]:
        """Return what the sensors say at the end of a period, the encoders last."""
        stamp_ns = period * PERIOD_NS
        z = self.pose + np.asarray(MEASUREMENT_STD) * self._rng.standard_normal(3)
        if period % HOUR == OUTLIER_AT:
            z[0] += 20.0
        events: list[Event] = [PoseFix(stamp_ns, z, np.zeros((3, 3)))]
        if not SILENT_AT <= period % HOUR < SILENT_AT + SILENCE:
            events.append(CompassYaw(stamp_ns, float(z[2])))
        counts = np.floor(self._travel / self._meters_per_count)
        modulus = 2**PARAMETERS.encoder_bits
        return events + [
            WheelCount(stamp_ns, wheel, int(counts[wheel]) % modulus) for wheel in Wheel
        ]


def fault_in(estimate: Estimate, previous_ns: int | None) -> str:
    """Return what is wrong with an estimate; empty for nothing."""
    state = estimate.state
    if previous_ns is not None and estimate.stamp_ns != previous_ns + PERIOD_NS:
        return f"{(estimate.stamp_ns - previous_ns) * 1e-9:g} s after the one before"
    if estimate.stamp_ns % PERIOD_NS:
        return "no multiple of the period"
    if not np.all(np.isfinite(np.concatenate([state.mean, estimate.twist]))):
        return f"pose {state.mean}, twist {estimate.twist}"
    noise = np.concatenate([state.process_noise, state.measurement_noise])
    if not (np.all(np.isfinite(noise)) and np.all(noise > 0.0)):
        return f"noise {noise}"
    if not np.linalg.eigvalsh(state.covariance)[0] > 0.0:
        return f"covariance {state.covariance.tolist()}"
    return ""


def memory_mb() -> float:
    """Return the resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096 / 1e6


class Soak:
    """The run: the robot, the localizer, and what has been seen so far."""

    def __init__(self, seed: int) -> None:
        self._robot = Robot(seed)
        self._localizer = Localizer(PARAMETERS, networks_for(PARAMETERS))
        self._previous_ns: int | None = None
        self._scored, self._sum_of_squares = 0, 0.0  # no list: memory is what is looked at
        self._levels: Counter[str] = Counter()
        self.estimates = 0

    def period(self, period: int) -> None:
        """Run a period; raises RuntimeError if something is wrong."""
        self._robot.move(period)
        if period % HOUR == CARRIED_AT:
            self._robot.pose = self._robot.pose + np.array([20.0, 0.0, 0.0])
        for event in self._robot.events(period):
            self._look_at(period, self._localizer.add(event, period * PERIOD_NS))

    def _look_at(self, period: int, outputs: Sequence[Output]) -> None:
        for output in outputs:
            for status in output.statuses or ():
                if status.level > 0:
                    self._levels[f"{status.name} {status.level.name}"] += 1
            if output.estimate is None:
                continue
            wrong = fault_in(output.estimate, self._previous_ns)
            if wrong:
                raise RuntimeError(f"period {period}: {wrong}")
            self._previous_ns = output.stamp_ns
            self.estimates += 1
            error = output.estimate.state.mean[:2] - self._robot.pose[:2]
            if period > TROUBLED and not CARRIED_AT <= period % HOUR < CARRIED_AT + TROUBLED:
                square = float(error @ error)
                self._scored += 1
                self._sum_of_squares += square
                if square > LARGEST_ERROR**2:
                    raise RuntimeError(f"period {period}: off by {math.sqrt(square):.2f} m")

    def report(self, day: int, took_s: float) -> str:
        """Return the line of a day that is over, and begin the next one's."""
        rmse = math.sqrt(self._sum_of_squares / max(self._scored, 1))
        said = ", ".join(f"{name} {count}" for name, count in sorted(self._levels.items()))
        self._scored, self._sum_of_squares = 0, 0.0
        self._levels.clear()
        return (
            f"day {day}: {self.estimates} odom so far, position RMSE {rmse:.4f} m, "
            f"{memory_mb():.1f} MB, {took_s / 60.0:.1f} min; reports not OK: {said or 'none'}"
        )


def main() -> int:
    """Run; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--days", type=float, default=10.0, help="simulated days (10)")
    parser.add_argument("--seed", type=int, default=1, help="of everything random (1)")
    arguments = parser.parse_args()
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    soak, began, settled_mb = Soak(arguments.seed), time.monotonic(), 0.0
    periods = round(arguments.days * DAY)
    try:
        for period in with_progress(range(1, periods + 1), periods, "soak"):
            soak.period(period)
            if period == min(DAY, periods // 2):
                settled_mb = memory_mb()
            if settled_mb and period % HOUR == 0 and memory_mb() > settled_mb + MOST_GROWTH_MB:
                raise RuntimeError(f"memory grew from {settled_mb:.1f} to {memory_mb():.1f} MB")
            if period % DAY == 0 or period == periods:
                print(soak.report(-(-period // DAY), time.monotonic() - began))
    except RuntimeError as error:
        print(f"soak: {error}", file=sys.stderr)
        return 1
    print(
        f"soak: {arguments.days:g} simulated days, {soak.estimates} odom, every {PERIOD_NS / 1e6:g}"
        f" ms one; memory {settled_mb:.1f} MB after the first day, {memory_mb():.1f} MB at the end"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
