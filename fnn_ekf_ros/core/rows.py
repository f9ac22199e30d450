"""Rows of a measurement, and what follows from which of them are there."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import MEASUREMENT_SIZE, BoolArray, FloatArray, Row

FIX_ROWS = (Row.X, Row.Y, Row.LRF_YAW)
"""Rows of a fix, in the order of its covariance."""
SENSOR_COUNT = 2
COMPASS, LRF_POSE = range(SENSOR_COUNT)
"""The sensors, in this order wherever an axis is the sensors'."""
SENSOR_OF_ROW = np.array([LRF_POSE, LRF_POSE, COMPASS, LRF_POSE])
"""Whose each row is, rows as in `Row`."""
_ORDER = (*FIX_ROWS, Row.COMPASS_YAW)
"""In which rows are taken: after those of the fix its NIS is known, whatever the compass says."""
_COMBINATIONS = 1 << MEASUREMENT_SIZE

Taken = tuple[tuple[Row, BoolArray | None], ...]
"""Rows in the order in which they are taken, each with its robots `(*batch)`; None: all of them."""


class Rows(NamedTuple):
    """Some rows of the measurements of a batch.

    Attributes:
        each: `(4, *batch)` whether each row is one of them.
        of_sensor: `(2, *batch)` how many are each sensor's.
        total: `(*batch)` how many they are.
        fix: `(*batch)` whether any is a fix's.
        some: `(*batch)` whether there are any.
    """

    each: BoolArray
    of_sensor: FloatArray
    total: FloatArray
    fix: BoolArray
    some: BoolArray


def rows_where(each: BoolArray) -> Rows:
    """Return the rows that `(4, *batch)` says."""
    return _rows(each) if each.ndim > 1 else _rows_of_one(each.tobytes())


def in_order(each: BoolArray) -> Taken:
    """Return the rows that `(4, *batch)` says for any robot, as they are taken."""
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
    return Rows(each, of_sensor, total, fix, np.asarray(total > 0.0))


def _in_order(each: BoolArray) -> Taken:
    flat = each.reshape(MEASUREMENT_SIZE, -1)
    some = np.logical_or.reduce(flat, axis=1).tolist()
    all_of_them = np.logical_and.reduce(flat, axis=1).tolist()
    return tuple((row, None if all_of_them[row] else each[row]) for row in _ORDER if some[row])
