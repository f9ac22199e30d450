# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Monte Carlo studies: simulated recordings, every filter on the same data, scores."""
