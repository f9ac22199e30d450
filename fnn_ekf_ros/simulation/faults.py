# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Effects of faults on the robot itself: its motion, its encoders, its clock."""

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.parameters.faults import (
    WHEELS,
    ClockJump,
    Fault,
    Kidnap,
    Noise,
    SilentWheel,
    Slip,
    StuckWheel,
    TickGlitch,
    TickReset,
    UnequalWheels,
)
from fnn_ekf_ros.simulation.delivery import step_at
from fnn_ekf_ros.simulation.robot import EQUAL_WHEELS, RobotState

FaultT = TypeVar("FaultT", bound=Fault)
"""A kind of fault."""


class _Timed(NamedTuple):
    """A fault and the steps `[first, end)` in which it is on; both equal if it happens once."""

    fault: Fault
    first: int
    end: int


class Schedule:
    """The faults of a run by the robot's steps since its start; the first is step 1.

    Args:
        faults: of any kind.
    """

    def __init__(self, faults: Sequence[Fault]) -> None:
        self._timed: dict[type[Fault], list[_Timed]] = {}
        for fault in faults:
            timed = _Timed(fault=fault, first=max(step_at(fault.start), 1), end=step_at(fault.end))
            self._timed.setdefault(type(fault), []).append(timed)

    def on(self, kind: type[FaultT], step: int) -> list[FaultT]:
        """Return the lasting faults of a kind that are on in a step."""
        return [f for f, first, end in self._of(kind) if first <= step < end]

    def beginning(self, kind: type[FaultT], after: int, step: int) -> list[FaultT]:
        """Return the faults of a kind that begin later than step `after`, at `step` at last."""
        return [f for f, first, _ in self._of(kind) if after < first <= step]

    def _of(self, kind: type[FaultT]) -> list[tuple[FaultT, int, int]]:
        return self._timed.get(kind, [])  # type: ignore[return-value]

    def slip_std(self, step: int, usual: tuple[float, float]) -> tuple[float, float]:
        """Return the slip in a step, per 375 ms, from the usual one (m, rad)."""
        for fault in self.on(Slip, step):
            given = not math.isnan(fault.std[0])
            usual = fault.std if given else (fault.factor * usual[0], fault.factor * usual[1])
        return usual

    def radius_factors(self, step: int) -> FloatArray:
        """Return the wheels' true radii `(2,)` over the one in the parameters."""
        factors = EQUAL_WHEELS
        for fault in self.on(UnequalWheels, step):
            own = np.array([fault.wheel == wheel for wheel in WHEELS])
            factors = np.where(own, fault.factor, factors)
        return factors

    def carried(self, step: int, robot: RobotState) -> RobotState:
        """Return the robot where a kidnapping in this step puts it."""
        for fault in self.beginning(Kidnap, step - 1, step):
            pose = robot.pose + np.asarray(fault.move)
            pose[..., 2] = wrap_angle(pose[..., 2])
            robot = robot._replace(pose=pose)
        return robot

    def clock_jump_ns(self, step: int) -> int:
        """Return by how much the clock is set in a step [ns]."""
        return sum(round(f.size * 1e9) for f in self.beginning(ClockJump, step - 1, step))

    def noise_factor(self, step: int, topic: str) -> float:
        """Return a sensor's noise over its std."""
        return math.prod(f.factor for f in self.on(Noise, step) if f.topic == topic)


class Reading(NamedTuple):
    """The reading of a wheel's encoder.

    Attributes:
        ticks: the counter, not yet wrapped.
        turned: counts since the start, of which joint_states makes an angle.
        heard: whether it is sent.
    """

    ticks: int
    turned: int
    heard: bool


class Encoder:
    """The counter of a wheel.

    Args:
        wheel: `left` or `right`.
        start_count: the counter at the start.
        schedule: what goes wrong.
    """

    def __init__(self, wheel: str, start_count: int, schedule: Schedule) -> None:
        self._wheel, self._schedule = wheel, schedule
        self._ticks, self._turned = start_count, 0
        self._true_count, self._step = 0, 0

    def read(self, step: int, true_count: int) -> Reading:
        """Return the reading in a step, from the true count since the start."""
        if not self._mine(self._schedule.on(StuckWheel, step)):
            self._ticks += true_count - self._true_count
            self._turned += true_count - self._true_count
        for reset in self._mine(self._schedule.beginning(TickReset, self._step, step)):
            self._ticks = self._turned = reset.count
        glitches = self._mine(self._schedule.beginning(TickGlitch, self._step, step))
        wrong = sum(glitch.size for glitch in glitches)
        self._true_count, self._step = true_count, step
        heard = not self._mine(self._schedule.on(SilentWheel, step))
        return Reading(ticks=self._ticks + wrong, turned=self._turned + wrong, heard=heard)

    def _mine(self, faults: list[FaultT]) -> list[FaultT]:
        return [fault for fault in faults if self._wheel in fault.targets()]
