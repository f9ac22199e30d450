# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What an import of CSV files leaves out although it may be wanted, and what its sigmas are for."""

import re
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.recordings.csv_import import Columns, fix_covariances, sigma_columns
from fnn_ekf_ros.recordings.csv_tables import Table

NO_POSITIONS = frozenset(
    {
        "gt", "truth", "true", "ref", "sig", "sigma", "std", "stddev", "var", "cov", "rho", "err",
        "error", "v", "vel", "velocity", "speed", "w", "omega", "a", "acc", "accel", "gyro", "mag",
        "cmd", "anchor", "landmark", "beacon",
    }
)  # fmt: skip
"""Words in names of columns that are no measured position: truth, uncertainty, motion, places."""
YAW_WORDS = frozenset({"yaw", "theta", "heading", "compass", "azimuth"})
"""Words in names of columns of a yaw."""
COVARIANCE_PARAMETER = "lrf_use_message_covariance"
"""The parameter with which the localizer takes R of a fix from its message."""


def import_notes(
    table: Table, fixes: Table, columns: Columns, counts: Mapping[str, int]
) -> Iterator[str]:
    """Yield what to say of an import, a sentence each.

    Args:
        table: encoders, and what else it has.
        fixes: pose fixes; may be the same table.
        columns: that were imported.
        counts: of the messages, by topic.
    """
    used = {*columns.truth, *columns.fixes, columns.compass}
    if not counts.get(messages.LRF_POSE):
        yield _without_fixes(table, fixes, columns, used)
    elif not counts.get(messages.COMPASS) and len(columns.fixes) < 3:
        names = [name for name in _measured(table, used) if _words(name) & YAW_WORDS]
        there = f"'{table.path}' has {', '.join(names)}" if names else "no column looks like one"
        yield (
            "no yaw was imported, and the localizer needs one to start (or initial_pose): "
            f"--compass-column NAME takes one; {there}"
        )
    sigmas = sigma_columns(fixes, columns.fixes)
    if sigmas and counts.get(messages.LRF_POSE):
        yield from _of_sigmas(fixes, columns, sigmas)


def position_pairs(table: Table, used: Iterable[str]) -> list[tuple[str, str]]:
    """Return pairs of columns that may be measured positions: names that differ in x and y only.

    Args:
        table: of the columns.
        used: names of columns that are known to be something.
    """
    names = _measured(table, used)
    pairs = []
    for name in names:
        other = re.sub(r"(?<![a-z])x(?![a-z])", "y", name.lower())
        partner = next((each for each in names if each.lower() == other), None)
        if partner is not None and partner != name:
            pairs.append((name, partner))
    return pairs


def _without_fixes(table: Table, fixes: Table, columns: Columns, used: set[str]) -> str:
    """Return the sentence about fixes that are missing."""
    if columns.fixes:
        return (
            f"no fix was imported: no line of '{fixes.path}' has a number in each of "
            f"{', '.join(columns.fixes)}"
        )
    said = "no fixes were imported, and the localizer needs them"
    pairs = position_pairs(table, used)
    if not pairs:
        return f"{said}: --fixes CSV, or --fix-columns X Y of '{table.path}'"
    found = " and ".join(", ".join(pair) for pair in pairs)
    return f"{said}; '{table.path}' has {found}: --fix-columns {' '.join(pairs[0])} takes them"


def _of_sigmas(fixes: Table, columns: Columns, sigmas: list[str]) -> Iterator[str]:
    """Yield the sentences about the uncertainties of fixes."""
    poses = np.stack([fixes.column(name) for name in columns.fixes])
    covariances = fix_covariances(fixes, columns.fixes)[np.all(np.isfinite(poses), axis=0)]
    without = int(np.sum(~covariances.any(axis=(1, 2))))
    if without == len(covariances):
        yield (
            f"{', '.join(sigmas)} of '{fixes.path}' were not used: expected standard deviations of "
            f"{', '.join(columns.fixes)}, all greater than 0"
        )
        return
    yield (
        f"{', '.join(sigmas)} of '{fixes.path}' are the covariance of lrf_pose: the localizer uses "
        f"them with {COVARIANCE_PARAMETER}: true only (-p {COVARIANCE_PARAMETER}:=true)"
    )
    if without:
        yield (
            f"{without} of {len(covariances)} fixes have no usable {', '.join(sigmas)}: with "
            f"{COVARIANCE_PARAMETER} they are refused"
        )


def _measured(table: Table, used: Iterable[str]) -> list[str]:
    """Return the columns that may be measured and have numbers."""
    return [
        name
        for name, values in table.columns.items()
        if name not in used and not _words(name) & NO_POSITIONS and np.isfinite(values).any()
    ]


def _words(name: str) -> set[str]:
    return set(re.findall(r"[a-z]+", name.lower()))
