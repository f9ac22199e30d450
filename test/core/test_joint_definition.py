# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mode `joint` against its definition: scalar filters, the noise in use, other units."""

import dataclasses
import itertools
import math
from typing import NamedTuple

import numpy as np
import pytest
from joint_drives import (
    FAST,
    SCALE_OF_ROW,
    SETTLED,
    START_COVARIANCE,
    MakeAdaptation,
    MakeModel,
    at_end,
    joint_periods,
    learned,
    report,
    trained,
)
from periods import ALL_ROWS

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.evidence import CONSISTENT_SCALE, NEIGHBOR_STEP, STAR, TAIL_DEGREES_OF_FREEDOM
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.fuzzy import infer
from fnn_ekf_ros.core.joint import LONGEST_MEMORY, MEMORY_GROWTH
from fnn_ekf_ros.core.joint_filters import SLIP
from fnn_ekf_ros.core.joint_state import HYPOTHESES, PRIOR_INFORMATION
from fnn_ekf_ros.core.motion import displacement
from fnn_ekf_ros.core.state import FilterModel, start_filter


@pytest.fixture(scope="module")
def model(make_model: MakeModel, make_adaptation: MakeAdaptation) -> FilterModel:
    return make_model(adaptation=make_adaptation(mode="joint"))


class Scalar(NamedTuple):
    """Headings and variances of a star of filters that only turn."""

    heading: FloatArray
    variance: FloatArray


def predicted(star: Scalar, turn: float, q: FloatArray) -> Scalar:
    return Scalar(star.heading + turn, star.variance + q)


def likelihood_of(star: Scalar, z: float, r: FloatArray) -> FloatArray:
    S, nu = star.variance + r, TAIL_DEGREES_OF_FREEDOM
    e = (z - star.heading) ** 2 / S
    return -0.5 * (np.log(S) + (nu + 1.0) * np.log(1.0 + e / CONSISTENT_SCALE[1]))


def scalar_evidence(star: Scalar, z: float, r: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return score and information of heading and yaw; the others cannot be seen."""
    lead, S = z - star.heading, star.variance + r
    parts = [likelihood_of(star, z, r), np.log(S), lead / math.sqrt(S[0])]
    slope = [np.array([0.0, p[3] - p[4], 0.0, p[7] - p[8]]) / (2.0 * NEIGHBOR_STEP) for p in parts]
    factor = (TAIL_DEGREES_OF_FREEDOM + 1.0) / (TAIL_DEGREES_OF_FREEDOM + 3.0)
    return slope[0], factor * (0.5 * np.outer(slope[1], slope[1]) + np.outer(slope[2], slope[2]))


def test_turning_on_the_spot_equals_scalar_filters(model: FilterModel) -> None:
    """Everything from the definition: forecasts, score, information, network, memory, odds."""
    rng = np.random.default_rng(94)
    state = start_filter(model, np.zeros(3), START_COVARIANCE)
    # Rows of each: the start's noise, then the star of a learner; snapshots are of the settled's.
    stars = {k: Scalar(np.zeros(10), np.full(10, 0.018)) for k in (SETTLED, FAST)}
    snapshots: list[Scalar] = []
    checked = 0
    for i in range(120):
        joint, _ = learned(state)
        turn, measured = 0.1 * (-1.0) ** (i // 3) + 0.013, rng.random() < 0.7
        z = stars[FAST].heading[0] + turn + rng.normal(0.0, 0.4)
        rows = np.array([False, False, measured, False])
        offsets = {
            k: np.vstack([np.zeros(4), joint.log_scale[:, k] + STAR.T]) for k in (SETTLED, FAST)
        }
        q = {k: model.process_noise[1] * np.exp(offsets[k][:, 1]) for k in offsets}
        r = {k: model.measurement_noise[2] * np.exp(offsets[k][:, 3]) for k in offsets}
        stars = {k: predicted(stars[k], turn, q[k]) for k in stars}
        snapshots = [predicted(star, turn, q[SETTLED]) for star in snapshots]
        state, result = step(model, state, at_end(np.array([0.0, turn]), np.full(4, z), rows))
        after, _ = learned(state)
        if not measured:
            continue
        sources = {FAST: stars[FAST]}
        if len(snapshots) == 2:
            sources[SETTLED] = snapshots[0]
            checked += 1
            apart = likelihood_of(snapshots[0], z, r[SETTLED])
            w, v = joint.start_weight, after.start_weight
            if 0.1 < v < 0.9:
                odds = math.log(v / (1.0 - v)) - math.log(w / (1.0 - w))
                assert odds == pytest.approx(apart[0] - apart[1], abs=0.01)
        for k, star in sources.items():
            score, seen = scalar_evidence(Scalar(star.heading[1:], star.variance[1:]), z, r[k][1:])
            # The compass informs heading and yaw; what is known of the others does not fade.
            N, informed = joint.memory[:, k], np.array([False, True, False, True])
            fade = np.where(informed, np.sqrt(1.0 - 1.0 / N), 1.0)
            known = joint.information[..., k] - PRIOR_INFORMATION
            information = np.outer(fade, fade) * known + PRIOR_INFORMATION + seen
            np.testing.assert_allclose(after.information[..., k], information, rtol=0.0, atol=1e-8)
            u = np.linalg.solve(information, score)
            if k == SETTLED:
                np.testing.assert_allclose(report(result).explained, u, rtol=0.0, atol=1e-9)
            moved = joint.log_scale[:, k] + infer(model.adaptation.networks.joint.sets, -u).change
            np.testing.assert_allclose(after.log_scale[:, k], moved, rtol=0.0, atol=1e-9)
            grown = np.minimum(N + MEMORY_GROWTH * informed, LONGEST_MEMORY[k])
            np.testing.assert_array_equal(after.memory[:, k], grown)
        for k, star in stars.items():
            gain = star.variance / (star.variance + r[k])
            stars[k] = Scalar(
                star.heading + gain * (z - star.heading), (1.0 - gain) * star.variance
            )
        snapshots = [*snapshots, stars[SETTLED]][-2:]
    assert checked > 60


@pytest.mark.slow
def test_noise_in_use_is_the_start_times_the_weighted_scales(model: FilterModel) -> None:
    """Right noise, wheels that slide, loud fixes for long: every hypothesis has its time."""
    rng, truth = np.random.default_rng(95), np.zeros(3)
    state, dominant = start_filter(model, truth, START_COVARIANCE), set()
    for i in range(300):
        control = rng.uniform([0.05, -0.3], [0.3, 0.3])
        spread = np.sqrt(model.process_noise) * (20.0 if 60 <= i < 70 else 1.0)
        driven = control + spread * rng.standard_normal(2)
        truth = truth + displacement(model.motion_model, truth[2], driven)
        noise = np.sqrt(model.measurement_noise) * (10.0 if i >= 120 else 1.0)
        z = truth[[0, 1, 2, 2]] + noise * rng.standard_normal(4)
        state, result = step(model, state, at_end(control, z, ALL_ROWS))
        weights, joint = report(result).weights, learned(state)[0]
        assert np.sum(weights) == pytest.approx(1.0, abs=1e-12)
        assert np.min(weights) >= 0.0
        dominant.add(HYPOTHESES[int(np.argmax(weights))])
        settled, fast = joint.log_scale.T
        theta = weights[1:] @ np.array([settled, fast, settled + SLIP])
        np.testing.assert_allclose(report(result).log_scale, theta, rtol=0.0, atol=1e-12)
        Q, R = np.exp(theta[:2]), np.exp(theta[SCALE_OF_ROW])
        np.testing.assert_allclose(state.process_noise, model.process_noise * Q, rtol=1e-12)
        np.testing.assert_allclose(state.measurement_noise, model.measurement_noise * R, rtol=1e-12)
    assert dominant == set(HYPOTHESES)


def test_published_filter_runs_on_the_noise_in_use(
    make_model: MakeModel, model: FilterModel
) -> None:
    """Each step of it is one of the plain filter with the noise of the step before."""
    state, plain = trained(model), make_model()
    for epoch in itertools.chain(*joint_periods(np.random.default_rng(96), 20)):
        period = [epoch]
        same = start_filter(
            plain, state.mean, state.covariance, state.process_noise, state.measurement_noise
        )
        expected, _ = step(plain, same, period)
        state, _ = step(model, state, period)
        assert state.mean.tobytes() == expected.mean.tobytes()
        assert state.covariance.tobytes() == expected.covariance.tobytes()


def scaled_run(model: FilterModel, length: float, quarter_turns: int = 0) -> list[FloatArray]:
    """Return log scales and weights over time, with lengths in other units and a map turned."""
    unit = np.array([length, length, 1.0, 1.0])
    angle = 0.5 * math.pi * quarter_turns
    turned = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    scaled = dataclasses.replace(
        model,
        process_noise=tuple(np.array(model.process_noise) * unit[[0, 2]] ** 2),
        measurement_noise=tuple(np.array(model.measurement_noise) * unit**2),
    )
    covariance = START_COVARIANCE * np.outer(unit[:3], unit[:3])
    state, found = start_filter(scaled, np.array([0.0, 0.0, angle]), covariance), []
    for [epoch] in joint_periods(np.random.default_rng(97), 120, plain=True):
        z = np.concatenate([turned @ epoch.measurement[:2], epoch.measurement[2:] + angle])
        period = at_end(epoch.control * unit[[0, 2]], z * unit, ALL_ROWS)
        state, result = step(scaled, state, period)
        joint, _ = learned(state)
        found += [joint.log_scale.ravel(), report(result).log_scale, report(result).weights]
    return found


@pytest.mark.parametrize(("length", "quarter_turns"), [(2.0, 0), (5.0, 0), (0.1, 0), (1.0, 1)])
@pytest.mark.slow
def test_neither_units_nor_the_maps_axes_change_what_is_learned(
    model: FilterModel, length: float, quarter_turns: int
) -> None:
    for one, other in zip(
        scaled_run(model, 1.0), scaled_run(model, length, quarter_turns), strict=True
    ):
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-6)
