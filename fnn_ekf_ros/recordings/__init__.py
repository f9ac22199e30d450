# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Bags: reading, writing, what the localizer listens to, and runs read from them."""
