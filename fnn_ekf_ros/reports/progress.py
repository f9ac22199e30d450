# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Progress on a terminal, if tqdm is installed; silence elsewhere."""

import sys
from collections.abc import Iterable
from typing import TypeVar

T = TypeVar("T")
"""Item of an iterable."""


def with_progress(items: Iterable[T], total: int, label: str) -> Iterable[T]:
    """Return the items, and show on stderr how many of `total` have been taken."""
    if not sys.stderr.isatty():
        return items
    try:
        from tqdm import tqdm
    except ImportError:
        return items
    bar: Iterable[T] = tqdm(items, total=total, desc=label, leave=False, unit_scale=True)
    return bar
