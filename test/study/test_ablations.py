# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`joint` without one of its parts: what is held stays, and the rest is joint."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from localizers import feed, make_parameters, simulated

from fnn_ekf_ros.core import lasting_step
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.lasting.augmented import Component
from fnn_ekf_ros.core.lasting.compass_offset import log_odds, offset_of
from fnn_ekf_ros.core.lasting.members import FILTER_COUNT, MEMBERS, WITNESS, YAW_ERROR_STD
from fnn_ekf_ros.core.lasting.outages import start_outages
from fnn_ekf_ros.core.state import FilterState
from fnn_ekf_ros.study.ablations import (
    WITHOUT_LASTING_ERRORS,
    WITHOUT_OUTAGES,
    WITHOUT_YAW_ERRORS,
    real_filters,
    without_offset,
)
from fnn_ekf_ros.study.filters import JOINT, localizer_models
from fnn_ekf_ros.study.real import BatchStart, batch_start, recording_localizer, run_starts
from fnn_ekf_ros.study.starts import CORNERS, RIGHT
from fnn_ekf_ros.timeline.events import CompassYaw

PARAMETERS = make_parameters()
CELLS = (RIGHT, CORNERS[1])
OFFSET = 1.5
YAWS_LAST = np.array([member.yaw_std > 0.0 for member in MEMBERS])


def batch_of(arrivals: Any) -> BatchStart:
    localizer, recorder = recording_localizer(PARAMETERS)
    feed(localizer, arrivals)
    return batch_start(PARAMETERS, recorder.periods, CELLS)


@pytest.fixture(scope="module")
def turned() -> BatchStart:
    """20 s of a simulated robot whose compass is turned by `OFFSET`."""
    return batch_of(
        [
            each._replace(event=each.event._replace(yaw=each.event.yaw + OFFSET))
            if isinstance(each.event, CompassYaw)
            else each
            for each in simulated(11, 20.0).arrivals
        ]
    )


def states_of(name: str, batch: BatchStart) -> Iterator[FilterState]:
    which = real_filters(PARAMETERS)[name]
    return run_starts(which.model, batch, which.hold)


def test_the_filters_of_the_localizer_come_first_and_are_as_they_are() -> None:
    own, known = localizer_models(PARAMETERS), real_filters(PARAMETERS)
    assert list(known)[: len(own)] == list(own)
    assert list(known)[len(own) :] == [WITHOUT_LASTING_ERRORS, WITHOUT_OUTAGES, WITHOUT_YAW_ERRORS]
    assert len({which.label for which in known.values()}) == len(known)
    joint = known[JOINT].model
    assert known[WITHOUT_OUTAGES].model == known[WITHOUT_YAW_ERRORS].model == joint
    assert joint.follows_lasting_errors
    white = known[WITHOUT_LASTING_ERRORS].model
    assert (white.is_joint, white.follows_lasting_errors) == (True, False)


def test_without_outages_it_is_joint_until_the_first_outage_counts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(lasting_step, "MEMORY_NEEDED", 5.0)  # so that the first one does
    batch = batch_of(simulated(11, 20.0).arrivals)
    prior = start_outages((len(CELLS),)).log_weight
    same = []
    for joint, held in zip(states_of(JOINT, batch), states_of(WITHOUT_OUTAGES, batch), strict=True):
        assert joint.lasting is not None
        assert held.lasting is not None
        np.testing.assert_array_equal(held.lasting.outages.log_weight, prior)
        unweighed = np.array_equal(joint.lasting.outages.log_weight, prior)
        same.append(np.array_equal(held.mean, joint.mean))
        assert same[-1] == unweighed
    assert 0 < same.index(False) < len(same)


def test_without_yaw_errors_no_offset_is_believed(turned: BatchStart) -> None:
    """Joint believes it and corrects it, and so has a better yaw than without."""
    *_, joint = states_of(JOINT, turned)
    assert joint.lasting is not None
    assert joint.lasting.offset.believed[0]  # from the right noise
    for state in states_of(WITHOUT_YAW_ERRORS, turned):
        assert state.lasting is not None
        assert np.all(state.lasting.weights[YAWS_LAST] < 1e-200)
        np.testing.assert_allclose(state.lasting.weights.sum(axis=0), 1.0)
        assert not (state.lasting.offset.believed | state.lasting.offset.doubted).any()
        assert not np.any(offset_of(state.lasting.bank))
        assert np.all(log_odds(state.lasting.bank) < 0.0)
        w, x = state.lasting.weights, state.lasting.bank.mean[:2, : len(MEMBERS)]
        np.testing.assert_allclose(state.mean[:2], (w * x).sum(axis=1))  # of the weights held
    wrong = wrap_angle(state.mean[2] - joint.mean[2])
    assert wrong[0] > 0.25 * OFFSET


def test_a_witness_that_is_told_its_offset_is_conditioned_on_it() -> None:
    """Against the blocks of the covariance; a yaw from a compass is then as good as its noise."""
    rng = np.random.default_rng(5)
    root = rng.standard_normal((7, 7, FILTER_COUNT, 2))
    covariance = np.einsum("ik...,jk...->ij...", root, root)
    covariance[Component.YAW_OFFSET, :, WITNESS, 1] = 0.0
    covariance[:, Component.YAW_OFFSET, WITNESS, 1] = 0.0  # the second one has been told before
    mean = rng.standard_normal((7, FILTER_COUNT, 2))
    mean[Component.YAW_OFFSET, WITNESS, 1] = 0.0
    before = mean.copy(), covariance.copy()
    found = without_offset(Bank(mean, covariance))
    np.testing.assert_array_equal(mean, before[0])
    np.testing.assert_array_equal(covariance, before[1])
    others = np.arange(FILTER_COUNT) != WITNESS
    np.testing.assert_array_equal(found.mean[:, others], mean[:, others])
    np.testing.assert_array_equal(found.covariance[:, :, others], covariance[:, :, others])
    np.testing.assert_array_equal(found.mean[..., 1], mean[..., 1])
    np.testing.assert_array_equal(found.covariance[..., 1], covariance[..., 1])
    k, P, x = 6, covariance[:, :, WITNESS, 0], mean[:, WITNESS, 0]
    kept = np.linalg.inv(np.linalg.inv(P)[:k, :k])  # an information matrix without a row is told it
    np.testing.assert_allclose(found.covariance[:k, :k, WITNESS, 0], kept)
    told = x[:k] - P[:k, k] / P[k, k] * x[k]
    told[2] = wrap_angle(told[2])
    np.testing.assert_allclose(found.mean[:k, WITNESS, 0], told)
    assert not found.covariance[k, :, WITNESS].any()
    assert not found.covariance[:, k, WITNESS].any()
    assert not found.mean[k, WITNESS].any()


def test_the_witness_starts_with_the_noise_of_the_compass(turned: BatchStart) -> None:
    first = next(iter(states_of(WITHOUT_YAW_ERRORS, turned)))
    assert first.lasting is not None
    yaw = first.lasting.bank.covariance[2, 2, WITNESS]
    expected = turned.start.covariance[:, 2, 2] + YAW_ERROR_STD**2
    np.testing.assert_allclose(yaw, expected, rtol=0.2)  # and the wheels, since the reading
