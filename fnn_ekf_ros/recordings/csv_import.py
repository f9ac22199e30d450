# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Messages of a recording that comes as CSV files."""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.covariance import usable_covariance
from fnn_ekf_ros.files.fields import Fields
from fnn_ekf_ros.files.text_files import read_text
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import default_of
from fnn_ekf_ros.recordings.csv_tables import CsvError, Table

TRUTH_COLUMNS = ("gt_x", "gt_y", "gt_theta")
"""Columns of the ground truth: x, y [m] and yaw [rad]."""
FIX_COLUMNS = ("fix_x", "fix_y", "fix_theta")
"""Columns of the pose fixes: x, y [m] and yaw [rad]."""
SIGMA_COLUMNS = ("sig_x", "sig_y", "sig_theta")
"""Columns of the standard deviations of the fixes, in the order of `FIX_COLUMNS` [m, m, rad]."""
CORRELATION_COLUMN = "rho_xy"
"""Column of the correlation of the fixes' x and y."""
TICK_TOPICS = (messages.LEFT_TICKS, messages.RIGHT_TICKS)
"""Topics of the encoder counts, left and right."""
COMPASS_COLUMN = "heading_meas"
"""Column of the compass yaw [rad]."""
COUNTS_PER_REVOLUTION = 1000.0
"""Counts per revolution of the wheel that stands for a given distance per tick: any number does, as
the radius is made to fit."""
GEOMETRY_RANGES = {"wheel_base_m": (1e-3, 100.0), "metres_per_tick": (1e-6, 0.06)}
"""Smallest and largest value of each field of `--geometry` [m]; they are within the ranges of the
localizer's parameters."""
LARGEST_COUNT = 1e15
"""Largest count of an encoder: double precision holds whole numbers up to 9e15."""
FIRST_STAMP_S = 3.0
"""First stamp of a recording that began at or before 0 [s]: ROS time 0 means no time."""
LONGEST_TIMEOUT_S = 60.0
"""Largest `encoder_timeout` that is written [s], the end of that parameter's range."""


class Timed(NamedTuple):
    """A message and when it was recorded; sorts by time, then encoders last."""

    time_ns: int
    order: int
    topic: str
    message: Message


class Columns(NamedTuple):
    """Names of the columns; empty for what a recording does not have.

    Attributes:
        truth: x, y and, if there is one, yaw.
        fixes: likewise.
        compass: the yaw.
    """

    truth: list[str]
    fixes: list[str]
    compass: str


def chosen_columns(
    table: Table, given: Sequence[str] | None, default: Sequence[str], option: str
) -> list[str]:
    """Return the columns of x, y and, if there is one, yaw; none if there is no such data."""
    if given is not None:
        if len(given) not in (2, 3):
            raise CsvError(f"{option} {' '.join(given)}: expected two or three columns")
        for name in given:
            table.column(name)
        return list(given)
    found = [name for name in default if name in table.columns]
    if not found:
        return []
    for name in default[:2]:
        table.column(name)
    return found


def read_geometry(path: Path | None) -> dict[str, float]:
    """Return the geometry parameters; wheels of the size that fits the distance per tick."""
    if path is None:
        raise CsvError(
            "--geometry is needed: a JSON file with wheel_base_m and metres_per_tick, the "
            "distance between the wheels and the distance that a wheel rolls per tick [m]"
        )
    try:
        content = json.loads(read_text(path, "geometry file", CsvError))
    except (ValueError, RecursionError) as error:
        raise CsvError(f"'{path}' is not JSON: {error}") from None
    fields = Fields(
        content, f"'{path}'", CsvError, "an object with wheel_base_m and metres_per_tick"
    )
    base, per_tick = (
        fields.number_between(key, *GEOMETRY_RANGES[key], "m") for key in GEOMETRY_RANGES
    )
    return {
        "wheel_separation": base,
        "wheel_radius": per_tick * COUNTS_PER_REVOLUTION / (2.0 * math.pi),
        "encoder_counts_per_revolution": COUNTS_PER_REVOLUTION,
    }


def encoder_timeout(times: FloatArray) -> float:
    """Return how long a period has to wait for encoders that come at these times [s]."""
    default = float(default_of(LocalizerParameters, "encoder_timeout"))
    intervals = np.diff(times)
    if len(intervals) == 0:
        return default
    return min(max(default, round(1.5 * float(np.percentile(intervals, 95)), 3)), LONGEST_TIMEOUT_S)


def messages_of(
    table: Table, fixes: Table, columns: Columns, parameters: LocalizerParameters
) -> list[Timed]:
    """Return the messages of a recording in the order of time.

    Args:
        table: encoders, and what else it has.
        fixes: pose fixes; may be the same table.
        columns: which columns hold what.
        parameters: of the localizer, for the frames.

    Raises:
        CsvError: a column cannot be used.
    """
    earliest = min(np.min(table.column("t")), np.min(fixes.column("t")))
    shift = 0.0 if earliest > 0.0 else FIRST_STAMP_S - earliest
    parts: list[Iterable[Timed]] = [
        _wheels(table, shift),
        _truth(table, columns.truth, shift, parameters),
    ]
    if columns.compass:
        parts.append(_compass(table, columns.compass, shift, parameters))
    if columns.fixes:
        parts.append(_fixes(fixes, columns.fixes, shift, parameters))
    return sorted(
        (entry for part in parts for entry in part), key=lambda entry: (entry.time_ns, entry.order)
    )


def _ns(time: float, shift: float) -> int:
    return round((time + shift) * 1e9)


def _wheels(table: Table, shift: float) -> Iterator[Timed]:
    left, right = table.column("left_ticks"), table.column("right_ticks")
    for name, counts in (("left_ticks", left), ("right_ticks", right)):
        if not np.any(np.isfinite(counts)):
            raise CsvError(f"'{table.path}': column {name} is empty, expected cumulative counts")
        if not np.nanmax(np.abs(counts)) < LARGEST_COUNT:
            raise CsvError(
                f"'{table.path}': {name} reaches {np.nanmax(np.abs(counts)):g}, expected less "
                f"than {LARGEST_COUNT:g} counts"
            )
    for time, *readings in zip(table.column("t"), left, right, strict=True):
        stamp_ns = _ns(time, shift)
        for topic, count in zip(TICK_TOPICS, readings, strict=True):
            if math.isfinite(count):
                wrapped = (round(count) + 2**31) % 2**32 - 2**31
                yield Timed(
                    time_ns=stamp_ns,
                    order=1,
                    topic=topic,
                    message=Message(messages.TICKS_TYPE, {"data": wrapped}),
                )


def _truth(
    table: Table, columns: list[str], shift: float, parameters: LocalizerParameters
) -> Iterator[Timed]:
    if not columns:
        return
    nothing = np.zeros((6, 6))
    for time, *pose in zip(table.column("t"), *map(table.column, columns), strict=True):
        if math.isfinite(pose[0]) and math.isfinite(pose[1]):
            stamp_ns = _ns(time, shift)
            message = messages.odometry_message(
                stamp_ns, parameters.frame_id, parameters.base_frame, _with_yaw(pose),
                np.zeros(2), nothing, nothing,
            )  # fmt: skip
            yield Timed(time_ns=stamp_ns, order=0, topic=messages.GROUND_TRUTH, message=message)


def _fixes(
    table: Table, columns: list[str], shift: float, parameters: LocalizerParameters
) -> Iterator[Timed]:
    poses = zip(table.column("t"), *map(table.column, columns), strict=True)
    for (time, *pose), covariance in zip(poses, fix_covariances(table, columns), strict=True):
        if not all(map(math.isfinite, pose)):
            continue
        stamp_ns = _ns(time, shift)
        fields = {
            "header": messages.header(stamp_ns, parameters.frame_id),
            "pose": messages.pose_with_covariance(
                _with_yaw(pose), messages.planar_covariance(covariance)
            ),
        }
        yield Timed(
            time_ns=stamp_ns,
            order=0,
            topic=messages.LRF_POSE,
            message=Message(messages.POSE_TYPE, fields),
        )


def sigma_columns(table: Table, columns: Sequence[str]) -> list[str]:
    """Return the columns of a table that tell the uncertainty of its fixes.

    Args:
        table: of the fixes.
        columns: of x, y and, if there is one, yaw of the fixes; none without fixes.
    """
    named = (*SIGMA_COLUMNS[: len(columns)], CORRELATION_COLUMN) if columns else ()
    return [name for name in named if name in table.columns]


def fix_covariances(table: Table, columns: Sequence[str]) -> FloatArray:
    """Return the covariance of each fix, `(n, 3, 3)` (m, m, rad); zeros where it came with none.

    Fixes without a yaw need no standard deviation of it.

    Args:
        table: of the fixes.
        columns: of x, y and, if there is one, yaw of the fixes.
    """
    rows = len(table.column("t"))
    found = np.zeros((rows, 3, 3))
    names = SIGMA_COLUMNS[: len(columns)]
    if not all(name in table.columns for name in names):
        return found
    sigmas = np.stack([table.columns[name] for name in names], axis=-1)
    correlations = table.columns.get(CORRELATION_COLUMN, np.zeros(rows))
    for index, (sigma, correlation) in enumerate(zip(sigmas, correlations, strict=True)):
        covariance = np.diag(sigma**2)
        covariance[0, 1] = covariance[1, 0] = correlation * sigma[0] * sigma[1]
        if usable_covariance(covariance) is not None:
            found[index, : len(names), : len(names)] = covariance
    return found


def _compass(
    table: Table, column: str, shift: float, parameters: LocalizerParameters
) -> Iterator[Timed]:
    for time, yaw in zip(table.column("t"), table.column(column), strict=True):
        if math.isfinite(yaw):
            stamp_ns = _ns(time, shift)
            yield Timed(
                time_ns=stamp_ns, order=0, topic=messages.COMPASS,
                message=messages.compass_message(stamp_ns, parameters.base_frame, yaw, 0.0),
            )  # fmt: skip


def _with_yaw(pose: Sequence[float]) -> FloatArray:
    """Return [x, y, yaw]; NaN yaw where there is none."""
    yaw = pose[2] if len(pose) == 3 else math.nan
    return np.array([pose[0], pose[1], yaw])
