# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Localization of two-wheeled robots by an EKF that finds its own noise."""
