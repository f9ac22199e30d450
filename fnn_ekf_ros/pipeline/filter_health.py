"""What the localizer says about the filter: waiting, degraded, lost, moved, at a bound."""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import AdaptationMode
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.joint import calm_noise
from fnn_ekf_ros.core.state import FilterState
from fnn_ekf_ros.core.suspects import SUSPECTS
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.pipeline.belief import Values, belief_in_words
from fnn_ekf_ros.pipeline.blame import Blame
from fnn_ekf_ros.pipeline.configure import noise_bounds
from fnn_ekf_ros.pipeline.events import Estimate, Level, Move, Sensor, Status
from fnn_ekf_ros.pipeline.measuring_health import OTHERS
from fnn_ekf_ros.pipeline.start import Waiting
from fnn_ekf_ros.pipeline.watch import Watch

NOT_CORRECTED_NS = 5 * 10**9
"""If the wheels move for longer without an accepted fix or yaw the filter is degraded [ns]."""
LOST_POSITION_STD = 10.0
"""A degraded filter whose position is known worse is lost [m]."""
LOST_YAW_STD = 1.0
"""Likewise its yaw [rad]: a gate that has to let such yaws pass lets all of them pass."""
BOUND_TOLERANCE = 0.01
"""A standard deviation is at its bound if it is so close to it, as a part of it."""


class FilterLook(NamedTuple):
    """What the status rests on.

    Attributes:
        now_ns: ROS time [ns].
        state: the filter, or what it waits with.
        estimate: of the last period; None without one.
        watch: what is remembered of the last periods; None before the filter runs.
        found: who is to blame for what does not fit.
        mode: what is being adapted now.
        moved: a move of the pose that has not been told yet.
        missing: what a filter that waits waits for.
        failure: of a period, not told yet; otherwise empty.
        failed: how many periods have failed so far.
    """

    now_ns: int
    state: FilterState | Waiting
    estimate: Estimate | None
    watch: Watch | None
    found: Blame
    mode: AdaptationMode
    moved: Move | None
    missing: str
    failure: str
    failed: int


def filter_status(parameters: LocalizerParameters, look: FilterLook) -> Status:
    """Return how the filter is; of several troubles the worst comes first."""
    state = look.state
    asked = parameters.adaptation
    values: Values = (
        ("adaptation", asked if look.mode == asked else f"{asked}, disabled"),
        ("process noise std [m, rad]", _stds(state.process_noise)),
        ("measurement noise std [m, m, rad, rad]", _stds(state.measurement_noise)),
        ("periods that failed", str(look.failed)),
    )
    if isinstance(state, Waiting):
        message = look.failure or f"waiting for the first {look.missing}"
        return Status("filter", Level.WARN, message, values)
    values += (
        ("position std [m]", f"{_position_std(state):.3g}"),
        ("yaw std [rad]", f"{_yaw_std(state):.3g}"),
        *_of_result(look.estimate),
    )
    leads = zip(SUSPECTS, look.found.leads, strict=True)
    values += (("suspicion [nats]", ", ".join(f"{name} {lead:.1f}" for name, lead in leads)),)

    values += _moves(look.watch)

    lost, degraded = _uncorrected(look, state)
    troubles = [
        *lost,
        *([look.failure] if look.failure else []),
        *([move_in_words(look.moved)] if look.moved is not None else []),
        *_blame_in_words(look.found),
        *degraded,
        *_at_bounds(parameters, look.mode, state),
    ]
    if not troubles:
        return Status("filter", Level.OK, "running", values)
    level = Level.ERROR if lost else Level.WARN
    return Status("filter", level, "; ".join(troubles), values)


def _moves(watch: Watch | None) -> Values:
    if watch is None:
        return ()
    moved = watch.moved
    last = "none" if moved is None else f"{moved.way:.1f} m at {moved.stamp_ns * 1e-9:.1f} s"
    return (("moves", str(watch.moves)), ("last move", last))


def _of_result(estimate: Estimate | None) -> Values:
    if estimate is None or estimate.result is None:
        return ()
    result = estimate.result
    values: Values = (
        ("NIS", f"{float(result.nis):.3g}"),
        ("degrees of freedom", f"{int(result.degrees_of_freedom)}"),
    )
    return values if result.joint is None else values + belief_in_words(result.joint)


def _uncorrected(look: FilterLook, state: FilterState) -> tuple[list[str], list[str]]:
    """Return what makes the pose as good as lost, and what may yet."""
    lost: list[str] = []
    degraded: list[str] = []
    if look.watch is None:
        return lost, degraded
    for name, last_ns, std, unit, limit in (
        ("fix", look.watch.fix_ns, _position_std(state), "m", LOST_POSITION_STD),
        ("yaw", look.watch.yaw_ns, _yaw_std(state), "rad", LOST_YAW_STD),
    ):
        age_ns = look.now_ns - last_ns
        if age_ns <= NOT_CORRECTED_NS:
            continue
        what = "position" if name == "fix" else "yaw"
        driving = f"{age_ns * 1e-9:.1f} s of driving"
        since = f"no {name} accepted for {driving}: {what} std {std:.2g} {unit}"
        if std > limit:
            lost.append(f"lost: {since}")
        else:
            degraded.append(f"degraded: {since}")
    return lost, degraded


def move_in_words(moved: Move) -> str:
    """Return what is said of a move."""
    turned = f" and turned by {moved.turn:.2f} rad" if abs(moved.turn) > LOST_YAW_STD else ""
    return (
        f"the robot was carried, or the fixes jumped: moved by {moved.way:.1f} m{turned} to where "
        "the fixes agree"
    )


def _blame_in_words(found: Blame) -> list[str]:
    if found.culprit is not None:
        verb = "disagree" if found.culprit is Sensor.ENCODERS else "disagrees"
        return [f"{found.culprit} {verb} with {OTHERS[found.culprit]}"]
    if found.suspects:
        return [f"measurements contradict each other: {' or '.join(found.suspects)} is wrong"]
    return []


def _at_bounds(
    parameters: LocalizerParameters, mode: AdaptationMode, state: FilterState
) -> list[str]:
    """Return which noise the adaptation would move further if it could."""
    p = parameters
    Q, R = state.process_noise, state.measurement_noise
    if state.joint is not None:
        Q, R = calm_noise(state.joint, noise_bounds(p))
    noises: list[tuple[str, str, FloatArray, tuple[float, ...], tuple[float, ...]]] = []
    if mode.adapts_process_noise:
        low, high = p.process_noise_std_min, p.process_noise_std_max
        noises += [
            ("wheels' way", "m", Q[0], low[:1], high[:1]),
            ("wheels' turn", "rad", Q[1], low[1:], high[1:]),
        ]
    if mode.adapts_measurement_noise:
        low3, high3 = p.measurement_noise_std_min, p.measurement_noise_std_max
        noises += [
            ("fixes' x", "m", R[0], low3[:1], high3[:1]),
            ("fixes' y", "m", R[1], low3[1:2], high3[1:2]),
            ("compass", "rad", R[2], low3[2:], high3[2:]),
        ]
        if p.lrf_use_yaw:
            noises.append(("fixes' yaw", "rad", R[3], low3[2:], high3[2:]))
    found = []
    for name, unit, variance, (low_std,), (high_std,) in noises:
        std = float(np.sqrt(variance))
        if std <= low_std * (1.0 + BOUND_TOLERANCE):
            found.append(f"{name} noise at its lower bound {low_std:g} {unit}")
        elif std >= high_std * (1.0 - BOUND_TOLERANCE):
            found.append(f"{name} noise at its upper bound {high_std:g} {unit}")
    return found


def _stds(variances: FloatArray) -> str:
    return ", ".join(f"{value:.4g}" for value in np.sqrt(variances))


def _position_std(state: FilterState) -> float:
    return float(np.sqrt(np.max(np.linalg.eigvalsh(state.covariance[:2, :2]))))


def _yaw_std(state: FilterState) -> float:
    return float(np.sqrt(state.covariance[2, 2]))
