"""`import-csv CSV OUT`: a recording from elsewhere as a bag, with a matching parameter file.

CSV: `t` [s], `left_ticks`, `right_ticks` (cumulative), and if known `gt_x`, `gt_y` [m],
`gt_theta` [rad] and a heading `heading_meas` [rad]. `--fixes`: `t`, `fix_x`, `fix_y` [m],
`fix_theta` [rad], and if known `sig_x`, `sig_y`, `sig_theta`, `rho_xy`. An empty field or nan is
a value that is not there. `--geometry`: JSON with `wheel_base_m` and `metres_per_tick`.
"""

import argparse
import csv
import json
import math
import reprlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.bag_files import STORAGES, BagWriter, file_beside, refuse_existing
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.covariance import usable_covariance
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.files import render_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import build, default_of, finite_number
from fnn_ekf_ros.text_files import read_text
from fnn_ekf_ros.tools.progress import with_progress

TRUTH_COLUMNS = ("gt_x", "gt_y", "gt_theta")
FIX_COLUMNS = ("fix_x", "fix_y", "fix_theta")
TICK_TOPICS = (messages.LEFT_TICKS, messages.RIGHT_TICKS)
COMPASS_COLUMN = "heading_meas"
COUNTS_PER_REVOLUTION = 1000.0
"""Counts of the equivalent wheel that stands for a given way per tick."""
GEOMETRY_RANGES = {"wheel_base_m": (1e-3, 100.0), "metres_per_tick": (1e-6, 0.06)}
"""What a robot can have [m]; within the ranges of the localizer's parameters."""
LARGEST_TIME_S = 2.0**31 - 100.0
"""ROS stamps hold no more seconds [s]."""
LARGEST_COUNT = 1e15
"""Larger counts are not whole numbers any more in a CSV file."""
FIRST_STAMP_S = 3.0
"""Recordings that begin at or before 0 are shifted to begin here: ROS time 0 means no time [s]."""


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


class Timed(NamedTuple):
    """A message and when it was recorded; sorts by time, then encoders last."""

    time_ns: int
    order: int
    topic: str
    message: Message


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.description = __doc__
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("csv", metavar="CSV", type=Path, help="t, left_ticks, right_ticks, ...")
    parser.add_argument("out", metavar="OUT", type=Path, help="the bag to write (a new folder)")
    parser.add_argument(
        "--fixes", metavar="CSV", type=Path, help="pose fixes, if they have a file of their own"
    )
    parser.add_argument(
        "--geometry", metavar="JSON", type=Path, help="wheel base, way per tick (needed)"
    )
    parser.add_argument(
        "--truth-columns", metavar="COLUMN", nargs="+", help="x y [theta] (gt_x gt_y gt_theta)"
    )
    parser.add_argument(
        "--fix-columns", metavar="COLUMN", nargs="+",
        help="x y [theta] (fix_x fix_y fix_theta); in CSV if there is no --fixes",
    )  # fmt: skip
    parser.add_argument("--compass-column", metavar="COLUMN", help=f"heading ({COMPASS_COLUMN})")
    parser.add_argument("--storage", choices=STORAGES, default="mcap", help="format (mcap)")


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    refuse_existing(arguments.out)
    table = read_table(arguments.csv)
    fixes = table if arguments.fixes is None else read_table(arguments.fixes)
    truth_columns = _chosen(table, arguments.truth_columns, TRUTH_COLUMNS, "--truth-columns")
    fix_columns = _chosen(fixes, arguments.fix_columns, FIX_COLUMNS, "--fix-columns")
    if arguments.fixes is not None and not fix_columns:
        fixes.column(FIX_COLUMNS[0])
    compass = arguments.compass_column or (
        COMPASS_COLUMN if COMPASS_COLUMN in table.columns else None
    )
    parameters = build(
        LocalizerParameters,
        _geometry(arguments.geometry)
        | {
            "lrf_use_yaw": len(fix_columns) == 3,
            "encoder_timeout": _encoder_timeout(table.column("t")),
        },
    )

    earliest = min(np.min(table.column("t")), np.min(fixes.column("t")))
    shift = 0.0 if earliest > 0.0 else FIRST_STAMP_S - earliest
    timed = [
        *_wheels(table, shift),
        *_truth(table, truth_columns, shift, parameters),
        *(_compass(table, compass, shift, parameters) if compass else ()),
        *(_fixes(fixes, fix_columns, shift, parameters) if fix_columns else ()),
    ]
    for source in {table.path: table, fixes.path: fixes}.values():
        backwards = int(np.sum(np.diff(source.column("t")) < 0.0))
        if backwards:
            print(f"import-csv: '{source.path}': t goes back {backwards} times; rows are sorted")
    timed.sort(key=lambda entry: (entry.time_ns, entry.order))
    head = f"Localizer parameters for {arguments.out.name}, imported from {arguments.csv.name}."
    matching = render_parameter_file(LocalizerParameters, asdict(parameters), NODE_NAME, head)
    notes = {"source": arguments.csv.name}
    with BagWriter(arguments.out, arguments.storage, notes, matching) as bag:
        for entry in with_progress(timed, len(timed), "import-csv"):
            bag.write(f"/{entry.topic}", entry.message, entry.time_ns)
    counts = Counter(entry.topic for entry in timed)
    listed = ", ".join(f"{count} {topic}" for topic, count in counts.items())
    print(f"{arguments.out}: {listed}; {file_beside(arguments.out)}: matching localizer parameters")
    return 0


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


def _chosen(
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


def _geometry(path: Path | None) -> dict[str, float]:
    """Return the geometry parameters; wheels of the size that fits the way per tick."""
    if path is None:
        raise CsvError(
            "--geometry is needed: a JSON file with wheel_base_m and metres_per_tick, the "
            "distance between the wheels and the way of a wheel per tick [m]"
        )
    try:
        content = json.loads(read_text(path, "geometry file", CsvError))
    except (ValueError, RecursionError) as error:
        raise CsvError(f"'{path}' is not JSON: {error}") from None
    if not isinstance(content, dict):
        raise CsvError(f"'{path}': expected an object with wheel_base_m and metres_per_tick")
    base, way = (_positive(path, content, key) for key in ("wheel_base_m", "metres_per_tick"))
    return {
        "wheel_separation": base,
        "wheel_radius": way * COUNTS_PER_REVOLUTION / (2.0 * math.pi),
        "encoder_counts_per_revolution": COUNTS_PER_REVOLUTION,
    }


def _positive(path: Path, content: dict[str, Any], key: str) -> float:
    value = content.get(key)
    number = finite_number(value)
    low, high = GEOMETRY_RANGES[key]
    if number is None or not low <= number <= high:
        raise CsvError(
            f"'{path}': {key} is {reprlib.repr(value)}, expected a number from {low:g} to {high:g} "
            "[m]"
        )
    return number


def _encoder_timeout(times: FloatArray) -> float:
    """Return how long a period must wait for encoders that come at these times [s]."""
    default = float(default_of(LocalizerParameters, "encoder_timeout"))
    intervals = np.diff(times)
    if len(intervals) == 0:
        return default
    return min(max(default, round(1.5 * float(np.percentile(intervals, 95)), 3)), 60.0)


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
                yield Timed(stamp_ns, 1, topic, Message(messages.TICKS_TYPE, {"data": wrapped}))


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
            yield Timed(stamp_ns, 0, messages.GROUND_TRUTH, message)


def _fixes(
    table: Table, columns: list[str], shift: float, parameters: LocalizerParameters
) -> Iterator[Timed]:
    poses = zip(table.column("t"), *map(table.column, columns), strict=True)
    for index, (time, *pose) in enumerate(poses):
        if not all(map(math.isfinite, pose)):
            continue
        stamp_ns = _ns(time, shift)
        covariance = messages.planar_covariance(_fix_covariance(table, index))
        fields = {
            "header": messages.header(stamp_ns, parameters.frame_id),
            "pose": messages.pose_with_covariance(_with_yaw(pose), covariance),
        }
        yield Timed(stamp_ns, 0, messages.LRF_POSE, Message(messages.POSE_TYPE, fields))


def _fix_covariance(table: Table, index: int) -> FloatArray:
    """Return the covariance the fix came with, zeros if it came with none."""
    names = ("sig_x", "sig_y", "sig_theta")
    if not all(name in table.columns for name in names):
        return np.zeros((3, 3))
    sigma = np.array([table.columns[name][index] for name in names])
    covariance = np.diag(sigma**2)
    if "rho_xy" in table.columns:
        covariance[0, 1] = table.columns["rho_xy"][index] * sigma[0] * sigma[1]
        covariance[1, 0] = covariance[0, 1]
    return covariance if usable_covariance(covariance) is not None else np.zeros((3, 3))


def _compass(
    table: Table, column: str, shift: float, parameters: LocalizerParameters
) -> Iterator[Timed]:
    for time, yaw in zip(table.column("t"), table.column(column), strict=True):
        if math.isfinite(yaw):
            stamp_ns = _ns(time, shift)
            yield Timed(
                stamp_ns, 0, messages.COMPASS,
                messages.compass_message(stamp_ns, parameters.base_frame, yaw, 0.0),
            )  # fmt: skip


def _with_yaw(pose: Sequence[float]) -> FloatArray:
    """Return [x, y, yaw]; NaN yaw where there is none."""
    yaw = pose[2] if len(pose) == 3 else math.nan
    return np.array([pose[0], pose[1], yaw])
