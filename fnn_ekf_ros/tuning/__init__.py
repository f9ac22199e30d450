# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Noise, lasting errors and calibration from recordings without a ground truth."""
