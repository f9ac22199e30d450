# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the localizer says about its own condition."""

import math
import re
from typing import Any

import numpy as np
import pytest
from localizers import Arrival, as_object, feed, make_localizer, simulated

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.joint_state import HYPOTHESES, JointReport
from fnn_ekf_ros.diagnostics.noise_words import noise_in_words
from fnn_ekf_ros.timeline.events import CompassYaw, Level, Output, PoseFix, Sensor

ESTIMATED = "estimated noise (std against the configured one)"
JOINT_KEYS = {ESTIMATED, "reason", "weights"}


def filter_values(outputs: list[Output]) -> list[dict[str, str]]:
    """Return what the reports say about the filter once it runs."""
    return [
        dict(status.values)
        for output in outputs
        for status in output.statuses or ()
        if status.name == "filter" and status.message == "running"
    ]


def numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"\d+(?:\.\d+)?(?:e[-+]\d+)?", text)]


def test_health_has_its_five_parts_about_once_a_second() -> None:
    outputs = feed(make_localizer(), simulated(11, 30.0).arrivals)
    reports = [output for output in outputs if output.statuses is not None]
    assert 28 <= len(reports) <= 34
    for output in reports:
        names = [status.name for status in output.statuses]
        assert names == ["encoders", "compass", "lrf_pose", "filter", "time"]
    assert {status.level for status in reports[-1].statuses} == {Level.OK}


def test_a_silent_sensor_is_warned_about() -> None:
    arrivals = simulated(11, 30.0).arrivals
    silent = [
        a for a in arrivals
        if not (isinstance(a.event, CompassYaw) and a.now_ns > arrivals[-1].now_ns - 10**10)
    ]  # fmt: skip
    last = [o for o in feed(make_localizer(), silent) if o.statuses is not None][-1]
    levels = {status.name: status.level for status in last.statuses}
    assert levels == {
        "encoders": Level.OK, "compass": Level.WARN, "lrf_pose": Level.OK, "filter": Level.WARN,
        "time": Level.OK,
    }  # fmt: skip
    assert "silent" in [s.message for s in last.statuses if s.name == "compass"]


PARKED_NS = 15 * 10**9


def parked(arrivals: Any, silent: tuple[type, ...], seconds: int, rate: int = 10) -> list[Any]:
    """Return arrivals of a robot that stops at 15 s; only some of its sensors go on."""
    before = [a for a in arrivals if a.now_ns <= PARKED_NS]
    last = {(type(e), getattr(e, "wheel", None)): e for _, e in before}
    return before + [
        Arrival(stamp, event._replace(stamp_ns=stamp))
        for number in range(1, seconds * rate)
        for stamp in [PARKED_NS + number * 10**9 // rate]
        for event in last.values()
        if not isinstance(event, silent)
    ]


def levels_of(outputs: list[Output]) -> dict[str, set[Level]]:
    """Return the levels of each status after the robot stopped."""
    found: dict[str, set[Level]] = {}
    for output in outputs:
        for status in output.statuses or () if output.stamp_ns > PARKED_NS + 10**9 else ():
            found.setdefault(status.name, set()).add(status.level)
    return found


def test_a_parked_robot_needs_no_fixes() -> None:
    """Fixes and yaws of a map, as AMCL sends them: none while the robot stands."""
    changes = {"adaptation": "none", "lrf_use_yaw": True, "process_noise_std": [0.05, 0.2]}
    arrivals = simulated(11, 30.0).arrivals
    silent = parked(arrivals, (PoseFix, CompassYaw), 40)
    moving = [a for a in silent if not isinstance(a.event, CompassYaw)]
    outputs = feed(make_localizer(**changes), moving)
    assert {level for levels in levels_of(outputs).values() for level in levels} == {Level.OK}
    last = {s.name: s for s in outputs[-1].statuses or outputs[-2].statuses or outputs[-3].statuses}
    assert last["lrf_pose"].message == (
        "no new fix, but the robot stands or stood: this does not count as silence"
    )
    assert 30.0 < float(dict(last["lrf_pose"].values)["age [s]"]) < 40.0
    assert float(dict(last["filter"].values)["yaw std [rad]"]) > 1.0


def test_a_robot_that_drives_on_needs_fixes_soon() -> None:
    pause = 20 * 10**9
    arrivals = simulated(11, 30.0).arrivals
    on = [
        Arrival(now_ns + pause, event._replace(stamp_ns=event.stamp_ns + pause))
        for now_ns, event in arrivals
        if now_ns > PARKED_NS and not isinstance(event, PoseFix)
    ]
    stopped = parked(arrivals, (PoseFix,), 20)
    outputs = feed(make_localizer(), stopped + on)
    first = {
        name: next(
            o.stamp_ns for o in outputs for s in o.statuses or ()
            if s.name == name and s.level is Level.WARN and o.stamp_ns > PARKED_NS and words in s[2]
        )
        for name, words in (("lrf_pose", "silent"), ("filter", "no fix accepted"))
    }  # fmt: skip
    assert 2.0 <= (first["lrf_pose"] - PARKED_NS - pause) * 1e-9 <= 4.5
    assert 4.0 <= (first["filter"] - PARKED_NS - pause) * 1e-9 <= 6.5


def test_a_compass_goes_on_while_the_robot_is_parked() -> None:
    silent = parked(simulated(11, 30.0).arrivals, (CompassYaw,), 20)
    found = levels_of(feed(make_localizer(), silent))
    assert found["compass"] == {Level.OK, Level.WARN}
    assert found["lrf_pose"] == {Level.OK}


def test_refused_messages_are_warned_about_once() -> None:
    localizer = make_localizer()
    fix = messages.Message(
        messages.POSE_TYPE,
        {
            "header": messages.header(10**9, "odom"),
            "pose": messages.pose_with_covariance(np.zeros(3), np.eye(6)),
        },
    )
    localizer.advance(10**9)
    rejected = localizer.receive(messages.LRF_POSE, as_object(fix), 10**9).rejected
    assert rejected is not None
    assert rejected.sensor is Sensor.LRF_POSE
    first = next(s for s in localizer.report() if s.name == "lrf_pose")
    assert first.level is Level.WARN
    assert first.message == "message refused: frame_id differs from the parameter frame_id"
    assert ("last refusal", rejected.reason) in first.values
    assert "in frame 'odom'" in rejected.reason
    assert ("refused", "1") in first.values
    second = next(s for s in localizer.report() if s.name == "lrf_pose")
    assert "refused" not in second.message
    assert ("last refusal", rejected.reason) in second.values
    assert ("refused", "1") in second.values


def report(factors: list[float], weights: list[float]) -> JointReport:
    """Return a report of estimated noise, as factors of standard deviations."""
    return JointReport(
        2.0 * np.log(np.array(factors)), np.zeros(4), np.zeros((4, 3)), np.array(weights)
    )


def test_what_a_sensor_sends_instead_is_said_until_it_has_a_reading() -> None:
    localizer = make_localizer(encoder_source="joint_states")

    def receive(second: int, *names: str) -> str | None:
        joints = {"header": messages.header(second * 10**9, ""), "name": list(names)}
        joints |= {key: np.zeros(len(names)) for key in ("position", "velocity", "effort")}
        message = as_object(messages.Message(messages.JOINT_STATES_TYPE, joints))
        localizer.receive(messages.JOINT_STATES, message, second * 10**9)
        encoders = next(s for s in localizer.report() if s.name == "encoders")
        return dict(encoders.values).get("passed over")

    said = receive(1, "wheel_l", "wheel_r")
    assert said is not None
    assert "'wheel_l', 'wheel_r', expected 'left_wheel_joint' (left_joint)" in said
    assert receive(2, "left_wheel_joint", "right_wheel_joint") is None
    assert receive(3, "arm") is None


def test_other_joints_are_no_reason_if_readings_of_the_wheels_are_dropped_or_refused() -> None:
    for position, late_s in ((0.0, 60), (np.nan, 0)):
        localizer = make_localizer(encoder_source="joint_states")
        for names_, value, behind in ((["arm"], 0.0, 0), (["left_wheel_joint"], position, late_s)):
            joints = {"header": messages.header((100 - behind) * 10**9, ""), "name": names_}
            joints |= {key: np.array([value]) for key in ("position", "velocity", "effort")}
            message = as_object(messages.Message(messages.JOINT_STATES_TYPE, joints))
            localizer.advance(100 * 10**9)
            localizer.receive(messages.JOINT_STATES, message, 100 * 10**9)
        encoders = next(s for s in localizer.report() if s.name == "encoders")
        assert "passed over" not in dict(encoders.values)


def test_estimated_noise_is_put_into_words() -> None:
    words = dict(noise_in_words(report([2.1, 1.0, 0.2, 0.333], [0.1, 0.86, 0.03, 0.01])))
    assert words == {
        ESTIMATED: "distance x 2.1, rotation x 1, fixes x 0.2, yaw x 0.33",
        "reason": "settled: the learned noise explains the measurements better",
        "weights": "start 0.10, settled 0.86, fast 0.03, slip 0.01",
    }


@pytest.mark.parametrize("leader", range(len(HYPOTHESES)))
def test_the_hypothesis_that_weighs_most_is_the_reason(leader: int) -> None:
    weights = [0.1] * len(HYPOTHESES)
    weights[leader] = 0.7
    words = dict(noise_in_words(report([1.0] * 4, weights)))
    assert words["reason"].split(":")[0] == HYPOTHESES[leader]


@pytest.mark.slow
def test_the_noise_of_joint_adaptation_is_reported() -> None:
    """Fixes' and compass noise five times too large: it has to say so, and to run on it."""
    start = [0.5, 0.5, 0.67]
    localizer = make_localizer(adaptation="joint", measurement_noise_std=start, lrf_yaw_std=0.67)
    values = filter_values(feed(localizer, simulated(11, 60.0, path="sim2").arrivals))
    assert all(value["adaptation"] == "joint" for value in values)
    last = values[-1]
    assert last["reason"].startswith("settled: ")
    distance, rotation, fixes, yaw = numbers(last[ESTIMATED])
    assert 0.13 < fixes < 0.3
    assert 0.13 < yaw < 0.3
    assert sum(numbers(last["weights"])) == pytest.approx(1.0, abs=0.02)
    in_use = numbers(last["measurement noise std [m, m, rad, rad]"])
    np.testing.assert_allclose(
        in_use, [0.5 * fixes, 0.5 * fixes, 0.67 * yaw, 0.67 * yaw], rtol=0.05
    )
    in_use = numbers(last["process noise std [m, rad]"])
    np.testing.assert_allclose(in_use, [0.05 * distance, math.radians(3.0) * rotation], rtol=0.05)


@pytest.mark.parametrize("mode", ["none", "r", "q", "rq"])
def test_other_modes_report_no_estimated_noise(mode: str) -> None:
    values = filter_values(feed(make_localizer(adaptation=mode), simulated(11, 30.0).arrivals))
    assert values
    for value in values:
        assert value["adaptation"] == mode
        assert not JOINT_KEYS & value.keys()


def test_estimated_noise_is_kept_while_adaptation_is_disabled() -> None:
    arrivals = simulated(11, 30.0).arrivals
    middle = len(arrivals) // 2
    localizer = make_localizer(adaptation="joint", measurement_noise_std=[0.5, 0.5, 0.67])
    feed(localizer, arrivals[:middle])
    localizer.enable_adaptation(False)
    values = filter_values(feed(localizer, arrivals[middle:]))
    assert {value["adaptation"] for value in values} == {"joint, disabled"}
    # Periods that were learned from are run again for late inputs, and learned from again.
    assert len({value[ESTIMATED] for value in values[3:]}) == 1
    assert numbers(values[-1][ESTIMATED])[2] < 0.5
