# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results: series of numbers, ratios of them, and the bars that they have to meet."""

import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

MET, MISSED = "met", "missed"
"""Outcomes of a bar."""


class Bar(NamedTuple):
    """Limit that a median has to meet.

    Attributes:
        limit: the bar, in the unit of the line.
        at_least: whether the median has to be at least the limit, or at most.
    """

    limit: float
    at_least: bool = False

    def outcome(self, median: float) -> str:
        """Return whether a median meets the bar."""
        met = median >= self.limit if self.at_least else median <= self.limit
        return MET if met else MISSED

    def __str__(self) -> str:
        return f"{'>=' if self.at_least else '<='} {self.limit:g}"


class Line(NamedTuple):
    """A line of a row's table.

    Attributes:
        what: what is measured.
        unit: its unit; "x" for a ratio.
        values: one for each round, at least one.
        bar: what its median is held against, if anything.
    """

    what: str
    unit: str
    values: Sequence[float]
    bar: Bar | None = None

    @property
    def median(self) -> float:
        """The median of the rounds."""
        return statistics.median(self.values)

    @property
    def outcome(self) -> str:
        """Whether the bar is met; empty without one."""
        return "" if self.bar is None else self.bar.outcome(self.median)

    def as_json(self) -> dict[str, Any]:
        """Return the line for the JSON file."""
        return {
            "what": self.what,
            "unit": self.unit,
            "median": self.median,
            "least": min(self.values),
            "most": max(self.values),
            "values": list(self.values),
            "bar": None if self.bar is None else str(self.bar),
            "outcome": self.outcome or None,
        }


def ratio(what: str, above: Line, below: Line, bar: Bar | None = None) -> Line:
    """Return the ratio of two lines, round by round: what is interleaved is compared in pairs."""
    pairs = zip(above.values, below.values, strict=True)
    return Line(what, "x", [a / b for a, b in pairs], bar)


class Result(NamedTuple):
    """Result of a row.

    Attributes:
        lines: the lines of its table.
        skipped: why it was not measured; empty if it was.
        said: sentences about this run of it.
    """

    lines: Sequence[Line] = ()
    skipped: str = ""
    said: Sequence[str] = ()

    def as_json(self) -> dict[str, Any]:
        """Return the result for the JSON file."""
        return {
            "skipped": self.skipped or None,
            "said": list(self.said),
            "lines": [line.as_json() for line in self.lines],
        }


class Context(NamedTuple):
    """Environment in which a row is measured.

    Attributes:
        root: the clone.
        build: folder for everything that is made on the way.
        against: commit that the batches are compared with.
        quick: whether few and short rounds are enough.
        say: shows progress.
    """

    root: Path
    build: Path
    against: str
    quick: bool
    say: Callable[[str], None]


class Row(NamedTuple):
    """A row of the benchmark.

    Attributes:
        name: what `--only` calls it.
        title: heading in the document.
        how: what is measured and how, and what follows from it, in Markdown.
        measure: measures it.
    """

    name: str
    title: str
    how: str
    measure: Callable[[Context], Result]


def missed(results: Mapping[str, Result]) -> list[str]:
    """Return the lines that miss their bars, with their rows."""
    return [
        f"{name}: {line.what}"
        for name, result in results.items()
        for line in result.lines
        if line.outcome == MISSED
    ]
