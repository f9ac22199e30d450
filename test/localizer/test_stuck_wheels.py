# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Wheels that fall silent, that never spoke, or that are stuck."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from localizers import PERIOD_NS, SECOND_NS, feed, make_localizer, simulated
from wheel_counts import AT_ORIGIN, BEGIN_NS, METERS_PER_COUNT, STEP_NS, encoder_reports, straight

from fnn_ekf_ros.localizer import history
from fnn_ekf_ros.timeline.events import CompassYaw, Level, PoseReset, Wheel, WheelCount


@pytest.mark.parametrize("wheel", list(Wheel))
def test_a_silent_wheel_is_named(wheel: Wheel) -> None:
    arrivals = straight("ticks", 600)
    since = BEGIN_NS + 10 * SECOND_NS
    kept = [a for a in arrivals if a.now_ns < since or a.event.wheel is not wheel]
    reports = encoder_reports(feed(make_localizer(**AT_ORIGIN), kept))
    said = [s for s in reports if f"{wheel.name.lower()} wheel silent" in s.message]
    assert len(said) >= 1
    assert {status.level for status in said} == {Level.ERROR}
    age_s = float(dict(said[0].values)[f"age of the {wheel.name.lower()} wheel [s]"])
    assert 3.0 <= age_s < 4.1
    other = Wheel(1 - wheel).name.lower()
    assert not any(f"{other} wheel" in status.message for status in reports)


def test_a_wheel_that_never_spoke_is_named() -> None:
    arrivals = [a for a in straight("ticks", 300) if a.event.wheel is Wheel.LEFT]
    last = encoder_reports(feed(make_localizer(**AT_ORIGIN), arrivals))[-1]
    assert (last.level, last.message) == (Level.ERROR, "no message yet from the right wheel")


def stuck_at(arrivals: Sequence[Any], wheel: Wheel, since_ns: int) -> list[Any]:
    held: Any = None
    changed = []
    for a in arrivals:
        now = a
        if isinstance(a.event, WheelCount) and a.event.wheel is wheel:
            if a.now_ns < since_ns:
                held = a.event.reading
            else:
                now = a._replace(event=a.event._replace(reading=held))
        changed.append(now)
    return changed


@pytest.mark.parametrize("adaptation", ["none", "joint"])
@pytest.mark.parametrize("wheel", list(Wheel))
@pytest.mark.slow
def test_a_stuck_wheel_is_named(adaptation: str, wheel: Wheel) -> None:
    arrivals = simulated(11, 30.0, path="sim2").arrivals
    stuck_ns = BEGIN_NS + 15 * SECOND_NS
    outputs = feed(make_localizer(adaptation=adaptation), stuck_at(arrivals, wheel, stuck_ns))
    name = f"{wheel.name.lower()} wheel stuck: "
    found = [
        (o.stamp_ns, s) for o in outputs for s in o.statuses or ()
        if s.name == "encoders" and "stuck" in s.message
    ]  # fmt: skip
    assert found
    assert all(s.message.startswith(name) and s.level is Level.ERROR for _, s in found)
    values = dict(found[0][1].values)
    assert float(values["count constant for [s]"]) >= 3.0
    by_wheels = float(values["rotation by the wheels meanwhile [rad]"])
    of_filter = float(values["rotation of the filter meanwhile [rad]"])
    assert abs(by_wheels) >= 0.5
    assert abs(by_wheels - of_filter) > 0.5 * abs(by_wheels)
    assert stuck_ns + 3 * SECOND_NS <= found[0][0] <= stuck_ns + 12 * SECOND_NS


@pytest.mark.parametrize("wheel", list(Wheel))
@pytest.mark.parametrize(
    ("adaptation", "assumed"), [("none", 0.2), ("none", 1.0), ("none", 5.0), ("joint", 0.2)]
)
@pytest.mark.slow
def test_a_robot_may_pivot_about_a_wheel(wheel: Wheel, assumed: float, adaptation: str) -> None:
    """Even where the configured noise of the filter is too small or too large."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        localizer = make_localizer(
            adaptation=adaptation, initial_pose=[0.0, 0.0, 0.0],
            process_noise_std=[0.05 * assumed, 0.05236 * assumed],
            measurement_noise_std=[0.1 * assumed, 0.1 * assumed, 0.134 * assumed],
        )  # fmt: skip
        outputs, yaw, count = [], 0.0, 0
        for number in range(1000):
            stamp = BEGIN_NS + number * STEP_NS
            count += 20
            side = 1.0 if wheel is Wheel.LEFT else -1.0
            yaw += side * 20 * METERS_PER_COUNT / 0.6
            yaw += 0.05236 * math.sqrt(STEP_NS / PERIOD_NS) * rng.standard_normal()
            if number % 5 == 0:
                seen = math.remainder(yaw + 0.134 * rng.standard_normal(), 2.0 * math.pi)
                outputs += localizer.add(CompassYaw(stamp, seen), stamp)
            outputs += localizer.add(WheelCount(stamp, Wheel(1 - wheel), count), stamp)
            outputs += localizer.add(WheelCount(stamp, wheel, 0), stamp)
        assert not [s.message for s in encoder_reports(outputs) if "stuck" in s.message]


def test_a_pose_that_is_set_is_no_turn() -> None:
    localizer, outputs = make_localizer(**AT_ORIGIN), []
    for number in range(400):
        stamp = BEGIN_NS + number * STEP_NS
        if number == 200:
            there = np.array([1.0, 2.0, 3.0])
            outputs += localizer.add(PoseReset(stamp, there, 1e-4 * np.eye(3)), stamp)
        outputs += localizer.add(WheelCount(stamp, Wheel.RIGHT, 10 * number), stamp)
        outputs += localizer.add(WheelCount(stamp, Wheel.LEFT, 0), stamp)
    assert not [s.message for s in encoder_reports(outputs) if "stuck" in s.message]


@pytest.mark.parametrize("relocated", [False, True])
def test_a_pose_that_the_gate_moves_is_no_turn(
    monkeypatch: pytest.MonkeyPatch, relocated: bool
) -> None:
    """The yaw jumps against the wheels' turn while a wheel stands: it may be stuck, or not."""
    run = history.run_period

    def jumping(model: Any, before: Any, inputs: Any) -> Any:
        after, result = run(model, before, inputs)
        if result is not None and inputs.counts.right == 13 * 150.0:
            turned = after.bank.mean - np.array([[0.0], [0.0], [1.0]])
            after = after._replace(bank=after.bank._replace(mean=turned))
            result = result._replace(relocated=np.array(relocated))
        return after, result

    monkeypatch.setattr(history, "run_period", jumping)
    sure = {"initial_pose_std": [0.1, 0.1, 0.01], "process_noise_std": [0.05, 0.001]}
    localizer, outputs = make_localizer(**AT_ORIGIN, **sure), []
    for number in range(400):
        stamp = BEGIN_NS + number * STEP_NS
        outputs += localizer.add(WheelCount(stamp, Wheel.RIGHT, 10 * number), stamp)
        outputs += localizer.add(WheelCount(stamp, Wheel.LEFT, 0), stamp)
    said = [s.message for s in encoder_reports(outputs) if "left wheel stuck" in s.message]
    assert bool(said) is not relocated


def test_encoders_that_are_not_there_are_an_error_after_a_while() -> None:
    localizer, levels = make_localizer(), []
    for number in range(40):
        outputs = localizer.advance(BEGIN_NS + number * PERIOD_NS)
        levels += [(o.stamp_ns, s.level) for o in outputs for s in encoder_reports([o])]
    assert levels
    assert [level for _, level in levels] == [
        Level.WARN if stamp <= levels[0][0] + 3 * SECOND_NS else Level.ERROR for stamp, _ in levels
    ]
    assert {level for _, level in levels} == {Level.WARN, Level.ERROR}
