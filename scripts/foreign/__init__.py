# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Scenarios of other localizers: what they are, how they are run, and their table."""
