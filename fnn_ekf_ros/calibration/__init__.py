# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What wheels, fixes and compass say about the robot's geometry, wiring and clocks."""
