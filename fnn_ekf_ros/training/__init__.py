# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Learning of the membership functions by steepest descent (Nguyen et al., eqs. 23 and 24)."""
