# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What a localizer published in a run, as arrays over time."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row
from fnn_ekf_ros.timeline.events import Level
from fnn_ekf_ros.timeline.trajectory import Trajectory


class Noise(NamedTuple):
    """The numbers of `~/noise` over time.

    Attributes:
        time_ns: `(n,)` stamps of the odom that they belong to [ns].
        values: `(n,)` by name; those of `NOISE_FIELDS` that were recorded.
    """

    time_ns: NDArray[np.int64]
    values: Mapping[str, FloatArray]

    def get(self, name: str) -> FloatArray:
        """Return the numbers of a name `(n,)`; 0 where it was not recorded, as the node says."""
        return self.values.get(name, np.zeros(len(self.time_ns)))

    def measured(self, row: Row) -> BoolArray:
        """Return in which periods a row was measured: an innovation is exactly 0 without one."""
        return np.asarray(self.get(f"innovation_{row.name.lower()}") != 0.0)

    def standardized(self, row: Row) -> FloatArray:
        """Return innovations over their standard deviations `(n,)`; 0 where not measured."""
        innovation = self.get(f"innovation_{row.name.lower()}")
        variance = self.get(f"innovation_variance_{row.name.lower()}")
        known = (innovation != 0.0) & (variance > 0.0) & np.isfinite(innovation)
        root = np.sqrt(np.where(known, variance, 1.0))
        return np.where(known, innovation / root, 0.0)


class StatusReport(NamedTuple):
    """What one status of /diagnostics said at a time.

    Attributes:
        time_ns: when [ns].
        level: how bad.
        message: in words.
    """

    time_ns: int
    level: int
    message: str


class WorstStatus(NamedTuple):
    """The worst of what /diagnostics said.

    Attributes:
        name: of the status.
        level: how bad.
        share: of its reports at this level.
        message: what it said most often then.
    """

    name: str
    level: int
    share: float
    message: str

    def __str__(self) -> str:
        return f"{self.name}: {self.message} ({self.share:.1%} of the reports)"

    @property
    def word(self) -> str:
        """The level as ROS calls it."""
        return ("OK", "WARN", "ERROR", "STALE")[min(self.level, 3)]


class Fixes(NamedTuple):
    """Pose fixes.

    Attributes:
        time_ns: `(n,)` stamps [ns].
        pose: `(n, 3)` (m, m, rad); NaN yaw where there is none.
    """

    time_ns: NDArray[np.int64]
    pose: FloatArray


@dataclass(frozen=True, slots=True)
class RunRecord:
    """What a localizer published in a run.

    Attributes:
        track: its odom.
        twist: `(n, 2)` what the wheels measured over each period (m/s, rad/s).
        noise: its `~/noise`; None if that was not recorded.
        statuses: reports of each status by its short name, in the order of time.
        fixes: the fixes that were recorded; None without their topic.
        parameters: the parameter file in the bag's metadata; empty if there is none.
    """

    track: Trajectory
    twist: FloatArray
    noise: Noise | None = None
    statuses: Mapping[str, list[StatusReport]] = field(default_factory=dict)
    fixes: Fixes | None = None
    parameters: str = ""

    def worst_status(self) -> WorstStatus | None:
        """Return the status that was worst, for longest; None if all were OK."""
        worst: WorstStatus | None = None
        for name, reports in self.statuses.items():
            level = max((report.level for report in reports), default=0)
            said = Counter(report.message for report in reports if report.level == level)
            share = said.total() / max(len(reports), 1)
            if level > Level.OK and (worst is None or (level, share) > (worst.level, worst.share)):
                worst = WorstStatus(name, level, share, said.most_common(1)[0][0])
        return worst


def noise_at(
    stamps_ns: list[int], seen: list[int], rows: list[FloatArray], names: list[str]
) -> Noise | None:
    """Return `~/noise`, which has no stamps, at the stamps of the odom that it was sent with.

    Args:
        stamps_ns: of all odom, in the order of recording [ns].
        seen: how many odom were recorded before each message.
        rows: the messages' numbers.
        names: of the numbers; those that are missing at the end of a row are left out.
    """
    if not rows or not stamps_ns:
        return None
    if len(rows) == len(stamps_ns):
        times = np.array(stamps_ns)
    else:  # a recording that begins late, or lost some
        times = np.array([stamps_ns[max(count - 1, 0)] for count in seen])
    width = min(len(names), *(len(row) for row in rows))
    table = np.array([row[:width] for row in rows])
    times, first = np.unique(times, return_index=True)
    return Noise(times, {name: table[first, i] for i, name in enumerate(names[:width])})
