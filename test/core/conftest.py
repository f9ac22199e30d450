# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the tests of the core share: the published membership sets, filters, the textbook EKF."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fnn_ekf_ros.core.adaptation import (
    Adaptation,
    AdaptationMode,
    FuzzyNetwork,
    InferenceKind,
    Networks,
)
from fnn_ekf_ros.core.arrays import FloatArray, components_first
from fnn_ekf_ros.core.bounds import NoiseBounds
from fnn_ekf_ros.core.fuzzy import FuzzySets
from fnn_ekf_ros.core.gate import gate_for
from fnn_ekf_ros.core.motion import MotionModel
from fnn_ekf_ros.core.state import FilterModel
from fnn_ekf_ros.membership.files import read_membership

# Nguyen et al., before learning; P, N, D, I, M, Z as the paper numbers them.
INITIAL = FuzzySets(
    positive_slope=-0.16,
    positive_center=-17.0,
    negative_slope=0.1,
    negative_center=13.0,
    decrease_slope=0.0,
    decrease_center=-100.0,
    increase_slope=0.1,
    increase_center=23.0,
    maintain_center=0.03,
    maintain_width=0.0,
    zero_center=0.03,
    zero_width=0.03,
)

# Nguyen et al., after learning.
PUBLISHED = FuzzySets(
    positive_slope=-0.1073,
    positive_center=-17.0995,
    negative_slope=0.1515,
    negative_center=13.8108,
    decrease_slope=-0.06552,
    decrease_center=-143.0,
    increase_slope=0.1030,
    increase_center=24.2000,
    maintain_center=0.0571,
    maintain_width=0.1779,
    zero_center=0.0467,
    zero_width=0.0620,
)

# Mode joint's arguments are log variances: it has sets of its own.
JOINT = read_membership("joint").sets


WIDE_BOUNDS = NoiseBounds(
    process_min=(1e-8, 1e-8),
    process_max=(1e2, 1e2),
    measurement_min=(1e-8, 1e-8, 1e-8, 1e-8),
    measurement_max=(1e2, 1e2, 1e2, 1e2),
)


def build_adaptation(
    mode: str = "r",
    kind: str = "tsukamoto",
    sets: FuzzySets | None = None,
    position_unit: float = 1e-6,
    yaw_unit: float = 1e-6,
    window_length: int = 45,
    bounds: NoiseBounds = WIDE_BOUNDS,
    process: FuzzyNetwork | None = None,
) -> Adaptation:
    """Return an adaptation in mm^2 and mrad^2 with limits nothing ordinary reaches.

    `process` is Q's network where it is another one.
    """
    if sets is None:
        sets = JOINT if mode == "joint" else PUBLISHED
    network = FuzzyNetwork(sets, position_unit, yaw_unit, change_limit=1e4)
    networks = Networks(network, process or network, network)
    return Adaptation(AdaptationMode(mode), InferenceKind(kind), networks, window_length, bounds)


def build_model(
    motion_model: MotionModel = MotionModel.EXACT_ARC,
    period_s: float = 0.375,
    process_noise: tuple[float, float] = (4e-4, 3.046e-4),
    measurement_noise: tuple[float, float, float, float] = (0.01, 0.01, 0.018, 0.018),
    adaptation: Adaptation | None = None,
) -> FilterModel:
    """Return a filter with the noise of the paper's simulation 1; without adaptation."""
    if adaptation is None:
        adaptation = build_adaptation(mode="none")
    return FilterModel(motion_model, period_s, process_noise, measurement_noise, adaptation)


def build_covariances(rng: np.random.Generator, count: int, size: int) -> FloatArray:
    """Return `(size, size, count)` symmetric positive definite matrices of ordinary condition."""
    root = rng.standard_normal((count, size, size))
    covariances = root @ np.swapaxes(root, -1, -2) + 0.1 * np.eye(size)
    return components_first(covariances, 2)


@pytest.fixture(scope="session")
def initial() -> FuzzySets:
    return INITIAL


@pytest.fixture(scope="session")
def published() -> FuzzySets:
    return PUBLISHED


@pytest.fixture(scope="session", params=[INITIAL, PUBLISHED], ids=["initial", "published"])
def either_set(request: pytest.FixtureRequest) -> Any:
    return request.param


@pytest.fixture(scope="session")
def make_adaptation() -> Callable[..., Adaptation]:
    return build_adaptation


@pytest.fixture(scope="session")
def make_model() -> Callable[..., FilterModel]:
    return build_model


@pytest.fixture(scope="session")
def model_of() -> Callable[..., FilterModel]:
    """Filters of a mode with a gate and with suspects."""

    def make(mode: str, *, gated: bool = True, suspects: bool = True) -> FilterModel:
        model = build_model(adaptation=build_adaptation(mode=mode, window_length=6))
        if gated:
            model = dataclasses.replace(model, gate=gate_for(1e-6, 1e-6))
        return dataclasses.replace(model, suspects=suspects)

    return make


@pytest.fixture(scope="session")
def random_covariances() -> Callable[[np.random.Generator, int, int], FloatArray]:
    return build_covariances
