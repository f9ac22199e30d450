# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The one base class of everything a user can put right; caught in one place, the command line."""


class FnnEkfError(Exception):
    """A mistake in what the user gave: one sentence with the value, and what was expected."""
