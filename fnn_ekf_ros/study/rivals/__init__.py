# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rival adaptive filters, each after its own paper and at the settings that suit it best.

Every module has `run(motion_model, recording, start, settings) -> Estimates`, a `Rival`, and
a frozen dataclass of settings whose defaults are the ones to compare with.
"""
