# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""With several readings a period: what depends on nothing else, bit for bit where it can be."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from periods import (
    FIX,
    MODES,
    START,
    START_COVARIANCE,
    arrays_of,
    bytes_of,
    one_of_batch,
    wild_epochs,
)

from fnn_ekf_ros.core.filter import fuse, step
from fnn_ekf_ros.core.results import Epoch
from fnn_ekf_ros.core.state import FilterModel, start_filter


@pytest.mark.slow
def test_joint_with_learning_disabled_from_the_start_is_the_plain_filter_bit_for_bit(
    model_of: Callable[..., FilterModel],
) -> None:
    """With gate, relocation hypothesis and suspects, and several readings a period."""
    plain, joint = model_of("none"), model_of("joint")
    held = dataclasses.replace(
        joint, adaptation=dataclasses.replace(joint.adaptation, learning=False)
    )
    rng, rejected = np.random.default_rng(113), 0
    a, b = (start_filter(model, START, START_COVARIANCE) for model in (plain, held))
    for _ in range(80):
        period = wild_epochs(rng, int(rng.integers(1, 5)))
        (a, one), (b, other) = step(plain, a, period), step(held, b, period)
        for name in ("mean", "covariance", "process_noise", "measurement_noise", "lead"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
        assert bytes_of(a.gate, a.relocation_hypothesis, a.pace) == bytes_of(
            b.gate, b.relocation_hypothesis, b.pace
        )
        suspects = [
            bytes_of(state.bank.filters(model.layout.suspects))
            for model, state in ((plain, a), (held, b))
        ]
        assert suspects[0] == suspects[1]
        for name in ("innovation", "innovation_variance", "nis", "sensor_nis", "rejected"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
        rejected += int(one.rejected.sum())
    assert rejected > 5
    assert a.lead.any()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.slow
def test_suspects_change_no_bit_of_the_published_filter_and_of_what_is_learned(
    model_of: Callable[..., FilterModel], mode: str
) -> None:
    """With gate and hypotheses, and several readings a period."""
    models = model_of(mode, suspects=True), model_of(mode, suspects=False)
    rng = np.random.default_rng(127)
    a, b = (start_filter(model, START, START_COVARIANCE) for model in models)
    rejected = hypotheses = led = 0
    for _ in range(60):
        period = wild_epochs(rng, int(rng.integers(1, 5)))
        (a, one), (b, other) = (
            step(model, state, period) for model, state in zip(models, (a, b), strict=True)
        )
        for name in ("mean", "covariance", "process_noise", "measurement_noise"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
        assert bytes_of(a.window, a.gate, a.relocation_hypothesis, a.pace) == bytes_of(
            b.window, b.gate, b.relocation_hypothesis, b.pace
        )
        assert bytes_of(a.joint or ()) == bytes_of(b.joint or ())
        assert bytes_of(*one.shown) == bytes_of(*other.shown)
        rejected += int(one.rejected.sum())
        hypotheses += int(a.relocation_hypothesis.active)
        led += bool(a.lead.any())
        assert not b.lead.any()
    assert rejected > 5
    assert hypotheses > 2
    assert led > 5


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("batch", [(), (3,)], ids=["one robot", "batch"])
@pytest.mark.slow
def test_nothing_that_is_given_is_changed_and_all_repeats_itself(
    model_of: Callable[..., FilterModel], mode: str, batch: tuple[int, ...]
) -> None:
    model, rng = model_of(mode), np.random.default_rng(114)
    mean = np.broadcast_to(START.reshape(3, *(1,) * len(batch)), (3, *batch))
    state = start_filter(model, mean, START_COVARIANCE)
    rejected = hypotheses = 0
    for _ in range(25):
        period = wild_epochs(rng, 2, batch)
        for array in arrays_of(state, *period):
            array.flags.writeable = False
        before = bytes_of(state, *period)
        first, second = step(model, state, period), step(model, state, period)
        assert bytes_of(*first) == bytes_of(*second)
        one, other = fuse(model, state, period[0]), fuse(model, state, period[0])
        assert bytes_of(one) == bytes_of(other)
        assert bytes_of(state, *period) == before
        state = first[0]
        rejected += bool(np.any(first[1].rejected))
        hypotheses += bool(np.any(state.relocation_hypothesis.active))
    assert rejected > 2
    assert hypotheses > 2


COMPARED = ("nis", "sensor_nis", "rejected", "relocated", "innovation")


@pytest.mark.parametrize("mode", ["none", "rq", "joint"])
def test_robots_of_a_batch_are_what_they_are_alone(
    model_of: Callable[..., FilterModel], mode: str
) -> None:
    """With outliers, hypotheses, relocations and suspects, each its own."""
    model, rng, runs = model_of(mode), np.random.default_rng(115), 3
    together = start_filter(model, np.repeat(START[:, None], runs, axis=1), START_COVARIANCE)
    alone = [start_filter(model, START, START_COVARIANCE) for _ in range(runs)]
    relocated = np.zeros(runs)
    for t in range(40):
        period = wild_epochs(rng, 3, (runs,))
        if t >= 15:  # one of them is elsewhere
            for epoch in period:
                epoch.measurement[:2, 1] = np.array([40.0, 5.0]) + rng.normal(0.0, 0.1, 2)
                epoch.available[:2, 1] = True
        together, result = step(model, together, period)
        relocated += result.relocated
        for i in range(runs):
            alone[i], single = step(
                model, alone[i], [one_of_batch(epoch, (i,)) for epoch in period]
            )
            got, steady = one_of_batch(together, (i,)), model.layout.steady
            pairs = [(got._replace(bank=(), noise=()), alone[i]._replace(bank=(), noise=()))]
            pairs += [(got.bank.filters(steady), alone[i].bank.filters(steady))]
            pairs += [(got.noise.filters(steady), alone[i].noise.filters(steady))]
            if alone[i].relocation_hypothesis.active:
                pairs += [
                    (part.filters(slice(-1, None)), other.filters(slice(-1, None)))
                    for part, other in zip(
                        (got.bank, got.noise), (alone[i].bank, alone[i].noise), strict=True
                    )
                ]
            else:
                inactive = alone[i].relocation_hypothesis._replace(
                    active=alone[i].relocation_hypothesis.active
                )
                pairs[0] = (
                    pairs[0][0]._replace(relocation_hypothesis=inactive),
                    pairs[0][1]._replace(relocation_hypothesis=inactive),
                )
                assert not got.relocation_hypothesis.active
            for a, b in pairs:
                for one, other in zip(arrays_of(a), arrays_of(b), strict=True):
                    np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-11)
            for name in (*COMPARED, "firing_strength"):
                one, other = (
                    getattr(one_of_batch(result._replace(shown=()), (i,)), name),
                    getattr(single, name),
                )
                np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-11)
    assert relocated[1] > 0.0 or mode != "none"  # where R is learned the gate opens meanwhile


def test_the_only_robot_of_a_batch_with_a_hypothesis_is_relocated_and_goes_on(
    model_of: Callable[..., FilterModel],
) -> None:
    model = model_of("joint", suspects=False)
    state = start_filter(model, np.zeros((3, 2)), START_COVARIANCE)
    rows = np.repeat(FIX[:, None], 2, axis=1)
    relocated = np.zeros(2)
    for t in range(25):
        z = np.zeros((4, 2))
        z[0, 1] = 20.0 * (t >= 5)
        state, result = step(model, state, [Epoch(np.zeros((2, 2)), 0.375, z, rows)])
        relocated += result.relocated
    np.testing.assert_array_equal(relocated, [0.0, 1.0])
    np.testing.assert_allclose(state.mean[0], [0.0, 20.0], atol=0.1)
    assert state.bank.mean.shape[1] == state.noise.process.shape[1] == model.layout.steady.stop
