# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The one base class of everything a user can put right, and the system's own errors in words.

Errors are caught in one place, the command line.
"""


class FnnEkfError(Exception):
    """A mistake in what the user gave: one sentence with the value, and what was expected."""


def reason_of(error: OSError | ValueError) -> str:
    """Return why the system refuses a file, without its number and the file's name."""
    return getattr(error, "strerror", None) or str(error)


def in_one_line(error: OSError) -> str:
    """Return an error of the system: the file, if it is about one, and the reason."""
    reason = reason_of(error)
    return reason if error.filename is None else f"'{error.filename}': {reason}"
