# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Stamped events in order: unwrapped wheels, epochs and periods, initialization."""
