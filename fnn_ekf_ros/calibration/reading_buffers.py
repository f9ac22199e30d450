# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Readings of a robot that drives, until the block that they are in is over."""

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray

SPACING_S = {"left": 0.02, "right": 0.02, "compass": 0.02, "fixes": 0.1}
"""Shortest time between two readings that are kept [s]: nothing changes much within it."""


class Buffers:
    """Readings of the blocks that are not over yet, each as a row that begins with its stamp."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in SPACING_S}

    def add(self, name: str, row: tuple[float, ...]) -> None:
        """Keep a reading; of a fast sensor not each."""
        rows = self._rows[name]
        if not rows or abs(row[0] - rows[-1][0]) >= SPACING_S[name]:
            rows.append(row)

    @property
    def count(self) -> int:
        """Number of readings."""
        return sum(map(len, self._rows.values()))

    def table(self, name: str, width: int) -> FloatArray:
        """Return the readings `(n, width)` in the order of their stamps, each stamp once."""
        table = np.array(self._rows[name], dtype=np.float64).reshape(-1, width)
        return table[np.unique(table[:, 0], return_index=True)[1]]

    def forget_before(self, time_s: float) -> None:
        """Drop the readings that are stamped before an instant [s]."""
        for name, rows in self._rows.items():
            self._rows[name] = [row for row in rows if row[0] >= time_s]
