# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Every parameter of every executable: its default, its limits, its sentence. Each lives once."""
