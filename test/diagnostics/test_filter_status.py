# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the filter's status says: waiting, degraded, lost, moved, at a bound, who does not fit."""

from typing import Any

import numpy as np
import pytest
from localizers import Arrival, feed, make_localizer, same_estimates, simulated, statuses

from fnn_ekf_ros.localizer import history
from fnn_ekf_ros.timeline.events import CompassYaw, Level, Output, PoseFix, Status, WheelCount

FIX_LOST_NS = 15 * 10**9


def last_status(outputs: list[Output], name: str = "filter") -> Status:
    reports = [output.statuses for output in outputs if output.statuses is not None]
    return next(status for status in reports[-1] if status.name == name)


def without(arrivals: Any, kind: type, after_ns: int) -> list[Any]:
    return [a for a in arrivals if not (isinstance(a.event, kind) and a.now_ns > after_ns)]


@pytest.mark.slow
@pytest.mark.parametrize("lasting_errors", [False, True])
def test_a_filter_without_fixes_says_how_long_and_how_large_its_uncertainty_is(
    lasting_errors: bool,
) -> None:
    localizer = make_localizer(lasting_errors=lasting_errors)
    outputs = feed(localizer, without(simulated(11, 30.0).arrivals, PoseFix, FIX_LOST_NS))
    status = last_status(outputs)
    assert status.level is Level.WARN
    degraded = [s for s in statuses(outputs, "filter") if "degraded: no fix" in s.message]
    ages = [float(dict(s.values)["driving since the last fix [s]"]) for s in degraded]
    assert 5.0 < ages[0] < 6.5
    assert ages[-1] > 15.0
    stds = [float(dict(s.values)["position std [m]"]) for s in degraded]
    assert stds == sorted(stds)
    # Errors of the fixes that may last are in it before the fixes are lost, too.
    assert stds[-1] > (1.1 if lasting_errors else 1.3) * stds[0]
    assert "no yaw" not in status.message


def test_a_filter_without_fixes_and_with_poor_wheels_is_lost() -> None:
    localizer = make_localizer(adaptation="none", process_noise_std=[2.0, 0.05])
    outputs = feed(localizer, without(simulated(11, 30.0).arrivals, PoseFix, FIX_LOST_NS))
    status = last_status(outputs)
    assert status.level is Level.ERROR
    assert status.message.startswith("lost: no fix accepted while driving")


def test_a_filter_without_a_compass_says_so() -> None:
    silent = without(simulated(11, 30.0).arrivals, CompassYaw, FIX_LOST_NS)
    status = last_status(feed(make_localizer(), silent))
    assert status.level is Level.WARN
    assert "degraded: no yaw accepted while driving" in status.message
    assert float(dict(status.values)["driving since the last yaw [s]"]) > 10.0


def test_a_kidnapped_robot_is_told_of_once() -> None:
    arrivals = [
        Arrival(now_ns, event._replace(pose=event.pose + np.array([12.0, 16.0, 0.0])))
        if isinstance(event, PoseFix) and now_ns > FIX_LOST_NS
        else Arrival(now_ns, event)
        for now_ns, event in simulated(11, 30.0).arrivals
    ]
    outputs = feed(make_localizer(), arrivals)
    told = [s for s in statuses(outputs, "filter") if "was carried" in s.message]
    assert len(told) == 1
    assert told[0].level is Level.WARN
    (move,) = [output.moved for output in outputs if output.moved is not None]
    assert move.distance == pytest.approx(20.0, abs=0.5)
    values = dict(last_status(outputs).values)
    assert values["moves"] == "1"
    assert values["last move, distance [m]"] == f"{move.distance:.1f}"
    assert values["last move, rotation [rad]"] == f"{move.rotation:.2f}"
    assert values["last move, stamp [s]"] == f"{move.stamp_ns * 1e-9:.1f}"
    assert last_status(outputs).message == "running"
    warned = [s for s in statuses(outputs, "lrf_pose") if s.level is Level.WARN]
    assert any("readings rejected: they disagree" in s.message for s in warned)
    assert {s.name for o in outputs if o.estimate for s in o.statuses or () if s.level} == {
        "lrf_pose", "filter",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"adaptation": "r", "measurement_noise_std_max": [1e3, 1e3, 0.135]},
         "compass noise at its upper bound measurement_noise_std_max"),
        ({"adaptation": "q", "process_noise_std_min": [0.05, 1e-4]},
         "distance noise at its lower bound process_noise_std_min"),
        ({"adaptation": "joint", "measurement_noise_std_min": [0.1, 1e-3, 1e-3]},
         "fixes' x noise at its lower bound measurement_noise_std_min"),
    ],
)  # fmt: skip
@pytest.mark.slow
def test_noise_that_starts_at_its_bound_is_told(changes: dict[str, Any], words: str) -> None:
    arrivals = simulated(11, 30.0).arrivals[:1500]
    found = statuses(feed(make_localizer(**changes), arrivals), "filter")
    first = next(s for s in found if "bound" in s.message)
    assert first.level is Level.WARN
    assert words in first.message
    fixed = feed(make_localizer(**(changes | {"adaptation": "none"})), arrivals)
    assert not any("bound" in status.message for status in statuses(fixed, "filter"))


def spoiled(arrivals: Any) -> list[Any]:
    """Return arrivals with a compass that is turned from 15 s on."""
    return [
        Arrival(now_ns, event._replace(yaw=event.yaw + 1.5))
        if isinstance(event, CompassYaw) and now_ns > FIX_LOST_NS
        else Arrival(now_ns, event)
        for now_ns, event in arrivals
    ]


def every_fourth_fix_late(arrivals: Any) -> list[Any]:
    """Return arrivals of which every fourth fix comes 1 s late, with the stamp it has."""
    late, count = [], 0
    for now_ns, event in arrivals:
        count += isinstance(event, PoseFix)
        delayed = isinstance(event, PoseFix) and count % 4 == 0
        late.append(Arrival(now_ns + 10**9 * delayed, event))
    return sorted(late, key=lambda a: a.now_ns)


def test_a_turned_compass_is_named_and_nobody_else() -> None:
    outputs = feed(make_localizer(), spoiled(simulated(11, 30.0).arrivals))
    warned = {s.name for o in outputs if o.estimate for s in o.statuses or () if s.level}
    assert warned == {"compass", "filter"}
    told = statuses(outputs, "filter")
    first = next(s for s in told if "compass disagrees with the other sensors" in s.message)
    suspicion = dict(first.values)["suspicion [nats]"]
    _, compass, _ = (float(words.split()[1]) for words in suspicion.split(", "))
    assert compass > 12.0
    last = last_status(outputs, "compass")
    assert last.message == "the yaw is off by a constant angle, which is corrected"
    assert float(dict(last.values)["yaw offset [rad]"]) == pytest.approx(1.5, abs=0.2)


@pytest.mark.parametrize("mode", ["none", "joint"])
@pytest.mark.slow
def test_who_is_suspected_never_touches_the_estimates(
    monkeypatch: pytest.MonkeyPatch, mode: str
) -> None:
    arrivals = every_fourth_fix_late(spoiled(simulated(11, 30.0).arrivals))
    watched = feed(make_localizer(adaptation=mode), arrivals)
    assert any("disagrees" in status.message for status in statuses(watched, "filter"))
    monkeypatch.setattr(history, "recent_after", lambda *_: None)
    unwatched = feed(make_localizer(adaptation=mode), arrivals)
    assert not any("disagrees" in status.message for status in statuses(unwatched, "filter"))
    same_estimates(watched, unwatched)


@pytest.mark.parametrize("lasting_errors", [False, True])
@pytest.mark.slow
def test_late_measurements_are_judged_as_if_they_had_come_in_time(lasting_errors: bool) -> None:
    arrivals = spoiled(simulated(11, 30.0).arrivals)
    arrivals = [a for a in arrivals if a.now_ns < arrivals[-1].now_ns - 2 * 10**9]
    rest = [a for a in arrivals if isinstance(a.event, WheelCount)][-1]
    told = []
    for heard in (arrivals, every_fourth_fix_late(arrivals)):
        localizer = make_localizer(lasting_errors=lasting_errors)
        feed(localizer, heard)
        for wait_ns in (10**9, 2 * 10**9):  # the last periods, and all that was late
            feed(localizer, [Arrival(rest.now_ns + wait_ns, rest.event._replace(
                stamp_ns=rest.now_ns + wait_ns))])  # fmt: skip
        values: dict[str, str] = {}
        for status in localizer.report():
            if status.name in ("compass", "lrf_pose", "filter"):
                values |= {f"{status.name} {key}": value for key, value in status.values}
        told.append({key: value for key, value in values.items() if "age" not in key})
    assert told[0] == told[1]
    rejected = int(told[0]["compass rejected of the last readings"])
    assert rejected > 3 or lasting_errors  # a turned compass is not rejected, its offset is unknown
