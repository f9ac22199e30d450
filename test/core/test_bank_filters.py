# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Each filter, robot and row of a bank is what it is alone, bit for bit where it can be."""

import numpy as np
from banks import (
    ALL_MASKS,
    BOTH_KINDS,
    BOTH_MODELS,
    FIX,
    UNIT,
    Covariances,
    all_bytes,
    corrected,
    corrected_by,
    one_filter,
    random_case,
)
from periods import NO_ROWS

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.core.bank import (
    Bank,
    Correction,
    Innovations,
    Noise,
    Readings,
    correct,
    innovate,
    noise_of_readings,
    predict,
)
from fnn_ekf_ros.core.motion import MotionModel


def parts(seen: Innovations, taken: Correction) -> list[FloatArray]:
    """Return all arrays of a correction, each with filters and batch as its last dimensions."""
    return [*seen, *taken.bank, taken.nis, taken.fix_nis, taken.determinant]


def test_without_any_row_nothing_changes(random_covariances: Covariances) -> None:
    P = random_covariances(np.random.default_rng(15), 1, 3)[..., 0]
    bank = one_filter([1.0, 2.0, 3.0], P)
    _, taken = corrected(bank, np.full(4, np.nan), np.ones(4), NO_ROWS)
    assert all_bytes(taken.bank) == all_bytes(bank)
    np.testing.assert_array_equal(
        [taken.nis, taken.fix_nis, taken.determinant], [[0.0], [0.0], [1.0]]
    )


@BOTH_KINDS
def test_masked_row_leaves_every_bit_as_if_it_had_not_been_there(
    random_covariances: Covariances, reported: bool
) -> None:
    """For other robots of the batch it is."""
    rng = np.random.default_rng(25)
    bank, noise, readings, fix = random_case(rng, random_covariances, 3)
    told = fix if reported else None
    together = corrected_by(
        bank, readings, noise_of_readings(noise, UNIT, told, readings.available)
    )
    for i in range(len(ALL_MASKS)):
        only = Bank(bank.mean[..., i], bank.covariance[..., i])
        own = Noise(noise.process[..., i], noise.measurement[..., i])
        available = readings.available[:, i]
        own = noise_of_readings(own, UNIT, fix[..., i] if reported else None, available)
        alone = corrected_by(only, Readings(readings.values[:, i], available), own)
        for one, other in zip(parts(*together), parts(*alone), strict=True):
            assert all_bytes(one[..., i]) == all_bytes(other)


def test_fix_that_is_rejected_leaves_every_bit_though_it_was_measured(
    random_covariances: Covariances,
) -> None:
    """Its rows are coupled for all robots of the batch, and taken by half of them."""
    rng = np.random.default_rng(32)
    bank, noise, readings, fix = random_case(rng, random_covariances, 3)
    readings = readings._replace(available=np.ones_like(readings.available))
    noise = noise_of_readings(noise, UNIT, fix, readings.available)
    seen = innovate(bank, readings, noise.measurement)
    rows = readings.available.copy()
    rows[FIX, ::2] = False
    everything = correct(bank, seen, noise, readings.available)
    compass = correct(bank, seen, noise, rows & (np.arange(4) == Row.COMPASS_YAW)[:, None])
    taken = correct(bank, seen, noise, rows)
    for half, expected in ((slice(0, None, 2), compass), (slice(1, None, 2), everything)):
        for one, other in zip(parts(seen, taken), parts(seen, expected), strict=True):
            assert all_bytes(one[..., half]) == all_bytes(other[..., half])
    nothing = correct(bank, seen, noise, np.zeros_like(rows))
    assert all_bytes(nothing.bank) == all_bytes(bank)


@BOTH_MODELS
@BOTH_KINDS
def test_filters_of_a_bank_equal_banks_of_one_bit_for_bit(
    random_covariances: Covariances, model: MotionModel, reported: bool
) -> None:
    """And slices of all that readings said are those of the filters."""
    rng = np.random.default_rng(26)
    bank, noise, readings, fix = random_case(rng, random_covariances, 5)
    noise = noise._replace(process=rng.uniform(1e-3, 1.0, noise.process.shape))
    control = rng.uniform(-0.5, 0.5, (2, len(ALL_MASKS)))
    told = fix if reported else None
    predicted = predict(model, bank, control, noise.process)
    used = noise_of_readings(noise, UNIT, told, readings.available)
    seen = innovate(predicted, readings, used.measurement)
    taken = correct(predicted, seen, used, readings.available)
    for f in range(5):
        which = slice(f, f + 1)
        alone = predict(model, bank.filters(which), control, noise.process[:, which])
        assert all_bytes(alone) == all_bytes(predicted.filters(which))
        own = noise_of_readings(noise.filters(which), UNIT, told, readings.available)
        assert (own.coupling is not None) == reported
        assert own.measurement.tobytes() == used.filters(which).measurement.tobytes()
        said = innovate(alone, readings, own.measurement)
        assert all_bytes(said) == all_bytes(seen.filters(which))
        corrections = [
            correct(alone, said, own, readings.available),
            correct(predicted.filters(which), seen.filters(which), used.filters(which),
                    readings.available),
        ]  # fmt: skip
        for found in corrections:
            assert all_bytes(found.bank) == all_bytes(taken.bank.filters(which))
            for one, other in zip(found[1:], taken[1:], strict=True):
                assert all_bytes(one) == all_bytes(other[which])


@BOTH_KINDS
def test_filters_that_no_reading_is_compared_with_stay_as_they_are(
    random_covariances: Covariances, reported: bool
) -> None:
    """The last filters of a bank, of which there are no innovations; bit for bit."""
    rng = np.random.default_rng(27)
    bank, noise, readings, fix = random_case(rng, random_covariances, 5)
    first, rest = slice(0, 3), slice(3, 5)
    used = noise_of_readings(
        noise.filters(first), UNIT, fix if reported else None, readings.available
    )
    seen = innovate(bank.filters(first), readings, used.measurement)
    taken = correct(bank, seen, used, readings.available)
    expected = correct(bank.filters(first), seen, used, readings.available)
    assert all_bytes(taken.bank.filters(first)) == all_bytes(expected.bank)
    assert all_bytes(taken.bank.filters(rest)) == all_bytes(bank.filters(rest))
    for one, other in zip(taken[1:], expected[1:], strict=True):
        assert all_bytes(one) == all_bytes(other)


@BOTH_MODELS
def test_a_batch_predicts_what_its_robots_do_alone(
    random_covariances: Covariances, model: MotionModel
) -> None:
    """To rounding: numpy may take other instructions for the sine of one than of many."""
    rng = np.random.default_rng(18)
    mean, P = rng.standard_normal((3, 2, 2, 3)), random_covariances(rng, 12, 3)
    P = P.reshape(3, 3, 2, 2, 3)
    control, Q = rng.uniform(-0.5, 0.5, (2, 2, 3)), rng.uniform(0.1, 1.0, (2, 2, 2, 3))
    together = predict(model, Bank(mean, P), control, Q)
    for i in np.ndindex(2, 3):
        bank = Bank(mean[:, :, *i], P[:, :, :, *i])
        alone = predict(model, bank, control[:, *i], Q[:, :, *i])
        np.testing.assert_allclose(together.mean[..., *i], alone.mean, rtol=1e-15, atol=1e-15)
        np.testing.assert_allclose(
            together.covariance[..., *i], alone.covariance, rtol=1e-13, atol=1e-14
        )


def test_arguments_are_not_changed(random_covariances: Covariances) -> None:
    rng = np.random.default_rng(19)
    bank, noise, readings, fix = random_case(rng, random_covariances, 2)
    for array in (*bank, *noise[:2], *readings, fix):
        array.flags.writeable = False
    predict(MotionModel.EXACT_ARC, bank, np.array([0.1, 0.2]), noise.process)
    used = noise_of_readings(noise, UNIT, fix, readings.available)
    assert used.coupling is not None
    seen = innovate(bank, readings, used.measurement)
    for array in (*used[:2], *used.coupling, *seen):
        array.flags.writeable = False
    correct(bank, seen, used, readings.available)
    correct(bank, seen, noise, readings.available)
