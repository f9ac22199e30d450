# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The status `filter`: waiting, degraded, lost, moved, at a bound, a sensor that disagrees."""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.calibration.findings import Finding
from fnn_ekf_ros.core.adaptation import AdaptationMode
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.joint_state import noise_without_alarms
from fnn_ekf_ros.core.lasting.report import LastingReport
from fnn_ekf_ros.core.state import FilterState
from fnn_ekf_ros.core.suspects import SUSPECTS
from fnn_ekf_ros.diagnostics.fault_isolation import FaultIsolation
from fnn_ekf_ros.diagnostics.lasting_words import lasting_in_words
from fnn_ekf_ros.diagnostics.messages import (
    MEASUREMENT_NOISES,
    PROCESS_NOISES,
    FilterMessage,
    fill,
    join,
)
from fnn_ekf_ros.diagnostics.mistakes import filter_messages
from fnn_ekf_ros.diagnostics.noise_words import Values, noise_in_words
from fnn_ekf_ros.diagnostics.recent_periods import RecentPeriods
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.events import Estimate, Level, Move, Sensor, Status
from fnn_ekf_ros.timeline.filter_model import noise_bounds
from fnn_ekf_ros.timeline.initialization import AwaitingStart

NOT_CORRECTED_NS = 5 * 10**9
"""Time of driving without an accepted fix or yaw from which on the filter is degraded [ns]: several
readings of the slowest sensors are missing then."""
LOST_POSITION_STD = 10.0
"""Standard deviation of the position from which on a degraded filter is lost [m]: larger than the
rooms and corridors that a robot drives in."""
LOST_YAW_STD = 1.0
"""Standard deviation of the yaw from which on a degraded filter is lost [rad]: a gate that has to
accept such yaws accepts all of them."""
BOUND_TOLERANCE = 0.01
"""Relative distance of a standard deviation to its bound within which it counts as at its bound:
adaptation approaches a bound without quite reaching it."""


class Failures(NamedTuple):
    """Periods that left the finite numbers.

    Attributes:
        total: their number so far.
        new: what diagnostics say of one since the last report; empty if there was none.
        reason: of the last one.
        end_ns: its end [ns]; None if there was none since the clock jumped last.
    """

    total: int = 0
    new: str = ""
    reason: str = ""
    end_ns: int | None = None


class FilterFacts(NamedTuple):
    """The facts that the status is made of.

    Attributes:
        now_ns: ROS time [ns].
        state: the filter, or what it waits with.
        estimate: of the last period; None without one.
        recent: the last periods; None before the filter runs.
        found: the sensor that does not fit the others.
        mistakes: of robot, wiring or configuration.
        lasting: what is believed of errors that last; None where they are not followed.
        mode: the adaptation in use.
        moved: a move of the pose that has not been reported yet.
        missing: what a filter that waits waits for.
        failures: periods that failed.
    """

    now_ns: int
    state: FilterState | AwaitingStart
    estimate: Estimate | None
    recent: RecentPeriods | None
    found: FaultIsolation
    mistakes: tuple[Finding, ...]
    lasting: LastingReport | None
    mode: AdaptationMode
    moved: Move | None
    missing: tuple[FilterMessage, ...]
    failures: Failures


def filter_status(parameters: LocalizerParameters, facts: FilterFacts) -> Status:
    """Return the status; of several troubles the worst comes first."""
    state, failure = facts.state, facts.failures.new
    values = _noise_values(parameters, facts) + _failure_values(facts.failures)
    if isinstance(state, AwaitingStart):
        return Status(
            name="filter", level=Level.WARN, message=failure or join(facts.missing), values=values
        )
    values += (
        ("position std [m]", f"{_position_std(state):.3g}"),
        ("yaw std [rad]", f"{_yaw_std(state):.3g}"),
        *_result_values(facts.estimate),
        *(() if facts.lasting is None else lasting_in_words(facts.lasting)),
    )
    leads = zip(SUSPECTS, facts.found.leads, strict=True)
    values += (("suspicion [nats]", ", ".join(f"{name} {lead:.1f}" for name, lead in leads)),)
    lost: list[str] = []
    degraded: list[str] = []
    if facts.recent is not None:
        values += _recent_values(facts.recent, facts.now_ns)
        lost, degraded = _uncorrected(facts.recent, facts.now_ns, state)
    troubles = [
        *lost,
        *([failure] if failure else []),
        *([FilterMessage.MOVED] if facts.moved is not None else []),
        *filter_messages(facts.mistakes),
        *_isolation_messages(facts.found),
        *degraded,
        *(() if facts.mistakes else _at_bounds(parameters, facts.mode, state)),
    ]
    if not troubles:
        return Status(name="filter", level=Level.OK, message=FilterMessage.RUNNING, values=values)
    return Status(
        name="filter",
        level=Level.ERROR if lost else Level.WARN,
        message=join(troubles),
        values=values,
    )


def _noise_values(parameters: LocalizerParameters, facts: FilterFacts) -> Values:
    configured = parameters.adaptation
    return (
        (
            "adaptation",
            configured if facts.mode == configured else f"{configured}, disabled",
        ),
        ("process noise std [m, rad]", _stds(facts.state.process_noise)),
        ("measurement noise std [m, m, rad, rad]", _stds(facts.state.measurement_noise)),
    )


def _failure_values(failures: Failures) -> Values:
    values: Values = (("periods that failed", str(failures.total)),)
    if failures.reason:
        values += (("reason of the last failure", failures.reason),)
    if failures.end_ns is not None:
        values += (("end of the last period that failed [s]", f"{failures.end_ns * 1e-9:.3f}"),)
    return values


def _recent_values(recent: RecentPeriods, now_ns: int) -> Values:
    values: Values = (
        ("driving since the last fix [s]", f"{max(now_ns - recent.fix_ns, 0) * 1e-9:.1f}"),
        ("driving since the last yaw [s]", f"{max(now_ns - recent.yaw_ns, 0) * 1e-9:.1f}"),
        ("moves", str(recent.moves)),
    )
    if recent.moved is not None:
        values += (
            ("last move, distance [m]", f"{recent.moved.distance:.1f}"),
            ("last move, rotation [rad]", f"{recent.moved.rotation:.2f}"),
            ("last move, stamp [s]", f"{recent.moved.stamp_ns * 1e-9:.1f}"),
        )
    return values


def _result_values(estimate: Estimate | None) -> Values:
    if estimate is None or estimate.result is None:
        return ()
    result = estimate.result
    values: Values = (
        ("NIS", f"{float(result.nis):.3g}"),
        ("degrees of freedom", f"{int(result.degrees_of_freedom)}"),
    )
    return values if result.joint is None else values + noise_in_words(result.joint)


def _uncorrected(
    recent: RecentPeriods, now_ns: int, state: FilterState
) -> tuple[list[str], list[str]]:
    """Return the messages of a filter that is lost, and those of one that is degraded."""
    lost: list[str] = []
    degraded: list[str] = []
    for last_ns, std, limit, lost_message, degraded_message in (
        (
            recent.fix_ns, _position_std(state), LOST_POSITION_STD,
            FilterMessage.LOST_POSITION, FilterMessage.DEGRADED_POSITION,
        ),
        (
            recent.yaw_ns, _yaw_std(state), LOST_YAW_STD,
            FilterMessage.LOST_YAW, FilterMessage.DEGRADED_YAW,
        ),
    ):  # fmt: skip
        if now_ns - last_ns > NOT_CORRECTED_NS:
            if std > limit:
                lost.append(lost_message)
            else:
                degraded.append(degraded_message)
    return lost, degraded


def _isolation_messages(found: FaultIsolation) -> list[str]:
    named = found.named
    if named is Sensor.ENCODERS:
        return [FilterMessage.WHEELS_DISAGREE]
    if named is not None:
        return [fill(FilterMessage.SENSOR_DISAGREES, measuring_sensor=named)]
    if found.suspects:
        return [fill(FilterMessage.CONTRADICTION, sensors=" or ".join(found.suspects))]
    return []


class _Bounds(NamedTuple):
    """Standard deviations between which adaptation moves a noise (m, rad)."""

    low: float
    high: float

    def at_low(self, std: float) -> bool:
        return std <= self.low * (1.0 + BOUND_TOLERANCE)

    def at_high(self, std: float) -> bool:
        return std >= self.high * (1.0 - BOUND_TOLERANCE)


def _at_bounds(
    parameters: LocalizerParameters, mode: AdaptationMode, state: FilterState
) -> list[str]:
    """Return the messages of noises that adaptation would move further if it could."""
    p = parameters
    Q, R = state.process_noise, state.measurement_noise
    if state.joint is not None:
        Q, R = noise_without_alarms(state.joint, noise_bounds(p))
    found: list[str] = []
    if mode.adapts_process_noise:
        bounds = map(_Bounds, p.process_noise_std_min, p.process_noise_std_max)
        for name, std, bound in zip(PROCESS_NOISES, np.sqrt(Q), bounds, strict=True):
            if bound.at_low(std):
                found.append(fill(FilterMessage.PROCESS_LOW, process_noise=name))
            elif bound.at_high(std):
                found.append(fill(FilterMessage.PROCESS_HIGH, process_noise=name))
    if mode.adapts_measurement_noise:
        low, high = p.measurement_noise_std_min, p.measurement_noise_std_max
        bounds = map(_Bounds, (*low, low[2]), (*high, high[2]))
        count = len(MEASUREMENT_NOISES) if p.lrf_use_yaw else len(MEASUREMENT_NOISES) - 1
        rows = list(zip(MEASUREMENT_NOISES, np.sqrt(R), bounds, strict=True))
        for name, std, bound in rows[:count]:
            if bound.at_low(std):
                found.append(fill(FilterMessage.MEASUREMENT_LOW, measurement_noise=name))
            elif bound.at_high(std):
                found.append(fill(FilterMessage.MEASUREMENT_HIGH, measurement_noise=name))
    return found


def _stds(variances: FloatArray) -> str:
    return ", ".join(f"{value:.4g}" for value in np.sqrt(variances))


def _position_std(state: FilterState) -> float:
    return float(np.sqrt(np.max(np.linalg.eigvalsh(state.covariance[:2, :2]))))


def _yaw_std(state: FilterState) -> float:
    return float(np.sqrt(state.covariance[2, 2]))
