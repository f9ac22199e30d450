# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The commands that work on files; each module has `add_arguments` and `run`."""
