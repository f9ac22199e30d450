# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Membership function files: packaged sets, and the reader of the users' own."""
