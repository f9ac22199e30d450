# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters that change while the localizer runs."""

from typing import Any

import numpy as np
import pytest
from localizers import Arrival, feed, make_localizer, make_parameters, same_estimates, simulated

from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.events import Output

MODES = ("none", "r", "q", "joint")


def change(localizer: Localizer, parameters: LocalizerParameters) -> None:
    localizer.change(parameters, networks_for(parameters))


def noise(outputs: list[Output]) -> np.ndarray[Any, Any]:
    """Q and R of each estimate, `(n, 6)`."""
    states = [output.estimate.state for output in outputs if output.estimate is not None]
    return np.array([[*state.process_noise, *state.measurement_noise] for state in states])


@pytest.mark.parametrize("before", MODES)
@pytest.mark.parametrize("after", MODES)
@pytest.mark.slow
def test_from_any_mode_to_any_other(before: str, after: str) -> None:
    arrivals = simulated(30, 40.0).arrivals
    middle = len(arrivals) // 2
    localizer = make_localizer(adaptation=before, innovation_window=6)
    first = noise(feed(localizer, arrivals[:middle]))
    change(localizer, make_parameters(adaptation=after, innovation_window=6))
    then = noise(feed(localizer, arrivals[middle:]))
    assert ("adaptation", after) in {s.name: s for s in localizer.report()}["filter"].values
    moves = {"none": [], "q": [0, 1], "r": [2, 3, 4], "joint": range(6)}
    for column in range(6):
        moved = bool(np.ptp(then[:, column]) > 0.0)
        assert moved == (column in moves[after]), column
    if after == "none" and before != "joint":  # which may have had an alarm
        np.testing.assert_array_equal(then[0], first[-1])


@pytest.mark.slow
def test_a_change_to_the_same_changes_nothing() -> None:
    arrivals = simulated(30, 30.0).arrivals
    middle = len(arrivals) // 2
    localizer = make_localizer()
    outputs = feed(localizer, arrivals[:middle])
    change(localizer, localizer.parameters)
    outputs += feed(localizer, arrivals[middle:])
    same_estimates(outputs, feed(make_localizer(), arrivals))


@pytest.mark.slow
def test_new_bounds_hold_from_the_next_period_on() -> None:
    arrivals = simulated(30, 40.0).arrivals
    middle = len(arrivals) // 2
    wrong = {"process_noise_std": [0.01, 0.01]}
    localizer = make_localizer(**wrong)
    before = noise(feed(localizer, arrivals[:middle]))
    assert np.sqrt(before[-1, 0]) > 0.0108
    bounds = {"process_noise_std_max": [0.0105, 0.0105]}
    change(localizer, make_parameters(**wrong, **bounds))
    after = noise(feed(localizer, arrivals[middle:]))
    assert np.all(np.sqrt(after[:, :2]) <= 0.0105 * (1.0 + 1e-12))


@pytest.mark.slow
def test_late_inputs_run_the_periods_before_a_change_as_they_were() -> None:
    """A fix that comes 1 s late, after the change, is fused where it was taken."""
    arrivals = simulated(30, 30.0).arrivals
    at_ns = arrivals[0].now_ns + 15 * 10**9
    late = next(
        a for a in arrivals if type(a.event).__name__ == "PoseFix" and a.now_ns > at_ns - 6 * 10**8
    )
    delayed = sorted(
        (a if a is not late else Arrival(a.now_ns + 10**9, a.event) for a in arrivals),
        key=lambda a: a.now_ns,
    )
    runs = []
    for order in (arrivals, delayed):
        localizer = make_localizer()
        feed(localizer, [a for a in order if a.now_ns < at_ns])
        change(localizer, make_parameters(adaptation="none"))
        runs.append(feed(localizer, [a for a in order if a.now_ns >= at_ns])[5:])
    same_estimates(*runs)


@pytest.mark.parametrize("after", ["r", "rq", "joint"])
@pytest.mark.slow
def test_noise_that_is_held_stays_held(after: str) -> None:
    arrivals = simulated(30, 40.0).arrivals
    middle = len(arrivals) // 2
    localizer = make_localizer(adaptation="q", innovation_window=6)
    feed(localizer, arrivals[:middle])
    localizer.enable_adaptation(False)
    change(localizer, make_parameters(adaptation=after, innovation_window=6))
    held = noise(feed(localizer, arrivals[middle:]))
    np.testing.assert_array_equal(held, np.broadcast_to(held[0], held.shape))
