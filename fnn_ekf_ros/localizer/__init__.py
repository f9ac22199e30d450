# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The one localizer that node, replay and studies drive, and its state file."""
