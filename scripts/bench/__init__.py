# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The benchmark of `make bench`: one module for each group of rows, with its worker processes."""
