# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Rows of a measurement: their sensors, their order, and how many there are."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import MEASUREMENT_SIZE, BoolArray, FloatArray, Row

POSITION_ROWS = (Row.X, Row.Y)
"""Rows of a fix's position."""
FIX_ROWS = (*POSITION_ROWS, Row.LRF_YAW)
"""Rows of a fix, in the order of its covariance."""
SENSOR_COUNT = 2
"""Sensors whose readings are gated; the length of the axis of sensors."""
COMPASS, LRF_POSE = range(SENSOR_COUNT)
"""Indices of the sensors on that axis."""
SENSOR_OF_ROW = np.array([LRF_POSE, LRF_POSE, COMPASS, LRF_POSE])
"""Index of the sensor that measures each row, rows as in `Row`."""
_ORDER = (*FIX_ROWS, Row.COMPASS_YAW)
"""Order in which the rows of an instant correct the filters: the compass comes last, so that the
fix's NIS does not depend on it."""
_COMBINATIONS = 1 << MEASUREMENT_SIZE
"""Sets of rows that one robot can measure; so many results are cached."""

Taken = tuple[tuple[Row, BoolArray | None], ...]
"""Rows in the order in which they are taken, each with its robots `(*batch)`; None: all robots."""


class Rows(NamedTuple):
    """A set of measurement rows for each robot of a batch.

    Attributes:
        each: `(4, *batch)` whether each row is in the set.
        of_sensor: `(2, *batch)` number of rows of each sensor.
        total: `(*batch)` number of rows.
        fix: `(*batch)` whether any row is a fix's.
        some: `(*batch)` whether there is any row.
    """

    each: BoolArray
    of_sensor: FloatArray
    total: FloatArray
    fix: BoolArray
    some: BoolArray


def rows_where(each: BoolArray) -> Rows:
    """Return the set of rows where `(4, *batch)` is true."""
    return _rows(each) if each.ndim > 1 else _rows_of_one(each.tobytes())


def in_order(each: BoolArray) -> Taken:
    """Return the rows where `(4, *batch)` is true for any robot, in the order they are taken."""
    return _in_order(each) if each.ndim > 1 else _in_order_of_one(each.tobytes())


@lru_cache(maxsize=_COMBINATIONS)
def _rows_of_one(each: bytes) -> Rows:
    return _rows(np.frombuffer(each, dtype=np.bool_))


@lru_cache(maxsize=_COMBINATIONS)
def _in_order_of_one(each: bytes) -> Taken:
    return _in_order(np.frombuffer(each, dtype=np.bool_))


def _rows(each: BoolArray) -> Rows:
    of_sensor = np.empty((SENSOR_COUNT, *each.shape[1:]))
    of_sensor[COMPASS] = each[Row.COMPASS_YAW]
    of_sensor[LRF_POSE] = each[list(FIX_ROWS)].sum(axis=0)
    total = np.asarray(of_sensor[COMPASS] + of_sensor[LRF_POSE])
    fix = np.asarray(of_sensor[LRF_POSE] > 0.0)
    return Rows(each=each, of_sensor=of_sensor, total=total, fix=fix, some=np.asarray(total > 0.0))


def _in_order(each: BoolArray) -> Taken:
    flat = each.reshape(MEASUREMENT_SIZE, -1)
    some = np.logical_or.reduce(flat, axis=1).tolist()
    all_of_them = np.logical_and.reduce(flat, axis=1).tolist()
    return tuple((row, None if all_of_them[row] else each[row]) for row in _ORDER if some[row])
