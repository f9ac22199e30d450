# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""CSV files of numbers."""

import csv
import math
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import read_text

LARGEST_TIME_S = 2.0**31 - 100.0
"""Largest time of a row [s]: the seconds of a ROS stamp have 31 bits."""


class CsvError(FnnEkfError):
    """A CSV or JSON file that cannot be used."""


class Table(NamedTuple):
    """A CSV file of numbers.

    Attributes:
        path: the file.
        columns: name to values `(n,)`; NaN where a field was empty.
    """

    path: Path
    columns: dict[str, FloatArray]

    def column(self, name: str) -> FloatArray:
        """Return a column.

        Raises:
            CsvError: there is none of that name.
        """
        if name not in self.columns:
            raise CsvError(
                f"'{self.path}' has no column '{name}': it has {', '.join(self.columns)}"
            )
        return self.columns[name]


def read_table(path: Path) -> Table:
    """Return a CSV file of numbers whose first column of times is `t`.

    Raises:
        CsvError: it cannot be read, has no rows or no `t`, or holds something that is no number.
    """
    lines = read_text(path, "CSV file", CsvError).splitlines()
    try:
        rows = list(csv.reader(lines))
    except csv.Error:
        raise CsvError(f"'{path}' is not a CSV file: expected text with commas") from None
    while rows and not rows[-1]:
        rows.pop()  # blank lines at the end
    if len(rows) < 2:
        raise CsvError(f"'{path}' has no data: expected a line of names and lines of numbers")
    names = [name.strip() for name in rows[0]]
    for name, number in Counter(names).items():
        if number > 1:
            raise CsvError(f"'{path}', line 1: {number} columns are named '{name}'")
    values = np.array([_values(path, line, names, row) for line, row in enumerate(rows[1:], 2)])
    table = Table(path, {name: values[:, index] for index, name in enumerate(names)})
    for line, time in enumerate(table.column("t"), start=2):
        if not abs(time) < LARGEST_TIME_S:
            raise CsvError(
                f"'{path}', line {line}: t is {time:g}, expected a time in seconds, less than "
                f"{LARGEST_TIME_S:g} (is it in milliseconds or nanoseconds?)"
            )
    return table


def _values(path: Path, line: int, names: list[str], row: list[str]) -> list[float]:
    if len(row) != len(names):
        raise CsvError(
            f"'{path}', line {line}: {len(row)} fields, expected {len(names)} as in line 1"
        )
    return [_number(path, line, name, text) for name, text in zip(names, row, strict=True)]


def _number(path: Path, line: int, name: str, text: str) -> float:
    if not text.strip():
        return math.nan
    try:
        number = float(text)
    except ValueError:
        number = math.inf
    if math.isinf(number) or "_" in text:
        raise CsvError(f"'{path}', line {line}: {name} is '{text[:40]}', expected a number")
    return number
