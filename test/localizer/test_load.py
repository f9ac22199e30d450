# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Work for a second of ROS time is bounded, in filter steps, however late and many inputs are."""

import numpy as np
import pytest
from localizers import SECOND_NS, make_parameters, time_values

from fnn_ekf_ros.localizer import history
from fnn_ekf_ros.localizer.history import MOST_REDONE
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.timeline.events import CompassYaw, Event, Output, PoseFix, Wheel, WheelCount
from fnn_ekf_ros.timeline.period import Period

BEGIN_NS = 10 * SECOND_NS
PERIOD_S = 0.02
DRIVEN_S = 3.0
STEP_NS = SECOND_NS // 100
LATE_NS = 1_900_000_000
PARAMETERS = {
    "period": PERIOD_S,
    "encoder_source": "joint_states",
    "initial_pose": [0.0, 0.0, 0.0],
    "adaptation": "none",
}


class Counted:
    """A localizer whose filter steps are counted."""

    def __init__(self, **changes: object) -> None:
        parameters = make_parameters(**PARAMETERS | changes)
        self.steps = 0
        self.localizer = Localizer(parameters, networks_for(parameters), on_period=self._count)

    def _count(self, period: Period) -> None:
        self.steps += len(period.inputs.epochs) + len(period.inputs.epochs_after_reset)


def inputs(late_ns: int, fix_every: int, compass_every: int) -> list[tuple[int, Event]]:
    """Return wheels at 100 Hz and measurements every so many steps, with the time of arrival."""
    rng = np.random.default_rng(3)
    found: list[tuple[int, Event]] = []
    for place in range(round(DRIVEN_S * SECOND_NS / STEP_NS)):
        now_ns = BEGIN_NS + place * STEP_NS
        seconds = place * STEP_NS / SECOND_NS
        x = 0.2 * seconds
        if place % fix_every == 0:
            pose = np.array([x, 0.0, 0.0]) + rng.normal(0.0, 0.02, 3)
            found.append((now_ns + late_ns, PoseFix(now_ns, pose, np.eye(3))))
        if place % compass_every == 0:
            found.append((now_ns + late_ns, CompassYaw(now_ns, rng.normal(0.0, 0.05))))
        found += [(now_ns, WheelCount(now_ns, wheel, x / 0.025)) for wheel in Wheel]
    for place in range(round(3 * SECOND_NS / STEP_NS)):  # the wheels go on until all is there
        now_ns = BEGIN_NS + round(DRIVEN_S * SECOND_NS) + place * STEP_NS
        found += [(now_ns, WheelCount(now_ns, wheel, 0.2 * DRIVEN_S / 0.025)) for wheel in Wheel]
    return sorted(found, key=lambda each: each[0])


def run(counted: Counted, arrivals: list[tuple[int, Event]]) -> list[Output]:
    return [o for now_ns, event in arrivals for o in counted.localizer.add(event, now_ns)]


def test_late_readings_are_fused_with_bounded_work() -> None:
    """Fixes at 5 Hz and a compass at 10 Hz, all late by 1.9 s: one rewind serves many of them."""
    counted, reference = Counted(), Counted()
    outputs = run(counted, inputs(LATE_NS, 20, 10))
    in_time = run(reference, inputs(0, 20, 10))
    seconds = DRIVEN_S + 3.0
    print(f"{counted.steps / seconds:.0f} steps a second, {reference.steps / seconds:.0f} in time")
    assert counted.steps < reference.steps + MOST_REDONE * (seconds + 1.0)
    last, expected = outputs[-1].estimate, in_time[-1].estimate
    assert last is not None
    assert expected is not None
    np.testing.assert_array_equal(last.state.mean, expected.state.mean)
    np.testing.assert_array_equal(last.state.covariance, expected.state.covariance)
    assert time_values(counted.localizer)["readings left out as the node is too slow"] == "0"


def test_too_many_late_readings_are_left_out_and_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With a tenth of the work allowed: what waits is kept for two `history`, not forever."""
    allowed = MOST_REDONE / 10.0
    monkeypatch.setattr(history, "MOST_REDONE", allowed)
    counted, in_time = Counted(), Counted()
    longest = 0
    for now_ns, event in inputs(LATE_NS, 20, 2):
        counted.localizer.add(event, now_ns)
        longest = max(longest, len(counted.localizer._history._checkpoints))
    run(in_time, inputs(0, 20, 2))
    assert longest <= history.LONGEST_KEPT * 2.0 / PERIOD_S + 2
    one_rewind = longest * 2
    assert counted.steps < in_time.steps + allowed * (DRIVEN_S + 4.0) + one_rewind
    assert int(time_values(counted.localizer)["readings left out as the node is too slow"]) > 0


@pytest.mark.parametrize("late_s", [0.3, 1.9])
def test_at_the_default_period_every_late_reading_is_fused_with_the_next_period(
    late_s: float,
) -> None:
    """Nothing waits: the rewinds of a whole `history` each period are less than the limit."""
    counted = Counted(period=0.375)
    arrivals = inputs(round(late_s * 1e9), 10, 5)
    for now_ns, event in arrivals:
        if counted.localizer.add(event, now_ns) and isinstance(event, WheelCount):
            kept = counted.localizer._history
            assert kept._changed_ns > kept.newest.stamp_ns
    assert int(time_values(counted.localizer)["periods run again for late inputs"]) > 5


def test_a_jump_of_the_clock_is_closed_in_parts() -> None:
    """A caller answers in between; what comes of it is the same."""
    jump_ns = BEGIN_NS + 30 * SECOND_NS
    at_once, in_parts = Counted(), Counted()
    for counted in (at_once, in_parts):
        counted.localizer.advance(BEGIN_NS)
    expected = at_once.localizer.advance(jump_ns)
    assert not at_once.localizer.is_behind
    found, steps = in_parts.localizer.advance(jump_ns, 10), []
    while in_parts.localizer.is_behind:
        before = in_parts.steps
        found += in_parts.localizer.advance(jump_ns, 10)
        steps.append(in_parts.steps - before)
    assert len(expected) > 1000
    assert max(steps) == 10
    assert [each.stamp_ns for each in found] == [each.stamp_ns for each in expected]
