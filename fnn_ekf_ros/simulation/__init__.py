# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The simulated robot: truth on exact arcs, and what its sensors make of it. No ROS, no files."""
