# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors of fixes and compass that last: hypotheses about them, weighed by simulated outages."""
