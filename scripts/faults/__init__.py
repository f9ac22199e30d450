# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The fault matrix: its rows, how they are run and recorded, what becomes of the recordings."""
