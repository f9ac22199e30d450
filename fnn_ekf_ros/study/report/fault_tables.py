# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results of `study faults` as Markdown and as rows for JSON."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fnn_ekf_ros.study.fault_naming import (
    NAMED_WITHIN_S,
    NAMING_CASES,
    PATHS,
    QUIET_PATHS,
    FaultCase,
    Naming,
    Quiet,
)
from fnn_ekf_ros.study.report.tables import command_head, plain, start_words, table
from fnn_ekf_ros.study.starts import Cell

HOW_TO_READ = f"""\
A fault begins 40 to 60 s after the start; runs take turns on the paths {", ".join(PATHS)}. Named:
within {NAMED_WITHIN_S:g} s the sensor's own status was WARN or worse, as it is where `filter` names
it. First: no other sensor's was before it. Alone: no other sensor's was at all in that time.
Quiet runs have no fault: the share of reports, from when the filter runs, in which any status is
WARN or worse; starts as in the other studies.
"""
"""Explains the tables."""


def head(made_by: Mapping[str, Any]) -> str:
    """Return the first lines: how the tables were made and how they are read."""
    options = {
        "runs": made_by["runs"],
        "quiet-runs": made_by["quiet_runs"],
        "quiet-seconds": f"{made_by['quiet_seconds']:g}",
        "seed": made_by["seed"],
    }
    if len(made_by["faults"]) < len(NAMING_CASES):
        options["faults"] = ",".join(made_by["faults"])
    return command_head(made_by, options, HOW_TO_READ)


def fault_tables(
    cases: Sequence[FaultCase], named: Sequence[Naming], quiet: Sequence[tuple[Cell, Quiet]]
) -> str:
    """Return the results in Markdown."""
    lines = []
    for case in cases:
        own = [naming for naming in named if naming.case is case]
        after = np.array([n.named_s for n in own if math.isfinite(n.named_s)])
        others = Counter(other for naming in own for other in naming.others)
        lines.append(
            [
                case.name,
                case.about,
                case.sensor,
                f"{sum(n.named for n in own)} of {len(own)}",
                str(sum(n.named_first for n in own)),
                str(sum(n.right for n in own)),
                f"{np.median(after):.1f}, {np.max(after):.1f}" if len(after) else "n/a",
                ", ".join(f"{other} {count}" for other, count in others.most_common()) or "-",
            ]
        )
    parts = [
        "\n## Faults\n",
        table(
            ["fault", "what it is", "sensor", "named", "first", "alone",
             "after [s]: median, longest", "others that were named"],
            lines,
        ),
        f"All: {shares(named)}.\n",
    ]  # fmt: skip
    if quiet:
        parts += ["## Quiet runs\n", _quiet_table(quiet)]
    return "\n".join(parts)


def shares(named: Sequence[Naming]) -> str:
    """Return how many faults were named, by each of the three measures."""
    count = len(named)
    said = (
        f"{words} {right} ({right / count:.1%})"
        for words, right in (
            ("named in time", sum(naming.named for naming in named)),
            ("before any other sensor", sum(naming.named_first for naming in named)),
            ("and no other at all", sum(naming.right for naming in named)),
        )
    )
    return f"of {count} faults {', '.join(said)}"


def _quiet_table(quiet: Sequence[tuple[Cell, Quiet]]) -> str:
    lines = []
    for cell in dict.fromkeys(cell for cell, _ in quiet):
        for path in QUIET_PATHS:
            own = [each for each_cell, each in quiet if each_cell == cell and each.path == path]
            reports, warned = sum(e.reports for e in own), sum(e.warned for e in own)
            words: Counter[str] = Counter()
            for each in own:
                words.update(each.words)
            most = "; ".join(f"{said} ({count})" for said, count in words.most_common(3))
            share = f"{warned / reports:.2%}" if reports else "n/a"
            lines.append([start_words(cell), path, str(reports), share, most or "-"])
    return table(["start", "path", "reports", "WARN or worse", "most frequent messages"], lines)


def naming_numbers(naming: Naming) -> dict[str, Any]:
    """Return what diagnostics reported of a fault, for JSON."""
    return {
        "fault": naming.case.name,
        "sensor": naming.case.sensor,
        "path": naming.path,
        "onset_s": naming.onset_s,
        "named_s": plain(naming.named_s),
        "named": naming.named,
        "first": naming.named_first,
        "alone": naming.right,
        "others": naming.others,
    }


def quiet_numbers(cell: Cell, quiet: Quiet) -> dict[str, Any]:
    """Return what diagnostics reported of a run without faults, for JSON."""
    return {"q": cell.q, "k": cell.k, **quiet._asdict(), "words": dict(quiet.words)}
