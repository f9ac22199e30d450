# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""How good a track is: its errors, whether its covariance is honest, and which of two is better."""
