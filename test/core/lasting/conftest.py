# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mode `joint` that follows lasting errors and begins with the noise of the drives."""

import dataclasses
from collections.abc import Callable

import pytest
from drives import TRUE_Q, TRUE_R

from fnn_ekf_ros.core.gate import gate_for
from fnn_ekf_ros.core.state import FilterModel


@pytest.fixture(scope="module")
def joint(
    make_model: Callable[..., FilterModel], make_adaptation: Callable[..., object]
) -> FilterModel:
    return dataclasses.replace(
        make_model(
            adaptation=make_adaptation(mode="joint"),
            process_noise=tuple(TRUE_Q),
            measurement_noise=tuple(TRUE_R),
        ),
        gate=gate_for(1e-6, 1e-6),
        lasting_errors=True,
    )
