# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The picture of tune."""

from pathlib import Path

import numpy as np
import pytest

from fnn_ekf_ros.reports.tuning_figure import COLUMNS, ProfilePanel, draw_profiles


@pytest.mark.parametrize("count", [1, COLUMNS, COLUMNS + 1])
def test_each_quantity_has_a_panel(tmp_path: Path, count: int) -> None:
    pytest.importorskip("matplotlib")
    values = np.linspace(0.5, 2.0, 13)
    panel = ProfilePanel("noise [m]", values, -((values - 1.0) ** 2), 1.0, 1.5, logarithmic=True)
    draw_profiles(tmp_path / "p.png", "drive", [panel] * count)
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
