# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the tests of the localizer share beside `support/localizers.py`."""

from typing import Any

import pytest
from localizers import JOINTS, MakePipeline

from fnn_ekf_ros.localizer.localizer import Localizer


@pytest.fixture
def pipeline(make_pipeline: MakePipeline) -> MakePipeline:
    """Pipelines that listen to joint states, which have no steps."""

    def make(**changes: Any) -> Localizer:
        return make_pipeline(**JOINTS, **changes)

    return make
