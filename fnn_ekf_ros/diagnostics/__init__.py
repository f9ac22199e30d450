# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Fault detection and isolation, and the statuses of /diagnostics."""
