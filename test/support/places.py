# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Where things are that tests read: the project's folders, and recordings of real robots."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BAGS, CONFIG, DOCS = (ROOT / name for name in ("bags", "config", "docs"))
FAULTS_EXAMPLE = CONFIG / "faults_example.yaml"
RECORDINGS = Path(os.environ.get("FNN_EKF_ROS_RECORDINGS", ROOT.parent / "shared" / "data"))
"""Recordings of real robots, which are not part of the project."""
needs_recordings = pytest.mark.skipif(
    not RECORDINGS.is_dir(),
    reason=f"no recordings of real robots in '{RECORDINGS}': FNN_EKF_ROS_RECORDINGS names their "
    "folder",
)
