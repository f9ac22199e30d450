# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The method: numpy only, pure functions, no ROS, files, clock, logging or global state."""
