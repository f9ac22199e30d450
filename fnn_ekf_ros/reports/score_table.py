# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Errors against the ground truth as tables of text."""

import math
from collections.abc import Mapping, Sequence

from fnn_ekf_ros.evaluation.evaluation import STATE_DEGREES, AgainstTruth, number

_ROW = "{:<28} {:>7} {:>9} {:>9} {:>11} {:>13} {:>9}"
"""Format of a row of the first table."""
_MORE = "{:<28} {:>9} {:>9} {:>11} {:>13} {:>13} {:>9} {:>9}"
"""Format of a row of the second table."""


def format_table(found: Mapping[str, AgainstTruth]) -> str:
    """Return root mean squares and mean NEES as a table, one line for each run."""
    lines = [
        _ROW.format("run", "odoms", "RMSE x", "RMSE y", "RMSE theta", "RMSE position", "mean NEES"),
        _ROW.format("", "", "[m]", "[m]", "[rad]", "[m], ATE", f"({STATE_DEGREES})"),
    ]
    for label, each in found.items():
        e, nees = each.errors, STATE_DEGREES * each.nees.ratio
        sizes = _texts(e.x.rmse, e.y.rmse, e.yaw.rmse, e.position.rmse)
        lines.append(
            _ROW.format(label, e.poses, *sizes, "n/a" if math.isnan(nees) else number(nees))
        )
    return "\n".join(lines)


def format_more(found: Mapping[str, AgainstTruth]) -> str:
    """Return largest and median errors and relative ones as a table, one line for each run."""
    (delta,) = {str(each.relative.delta) for each in found.values()}
    lines = [
        _MORE.format("run", "max x", "max y", "max theta", "max position", "median", "RPE", "RPE"),
        _MORE.format("", "[m]", "[m]", "[rad]", "[m]", "position [m]", f"{delta} [m]", "[rad]"),
    ]
    for label, each in found.items():
        e, relative = each.errors, each.relative
        sizes = (e.x.max, e.y.max, e.yaw.max, e.position.max, e.position.median)
        lines.append(
            _MORE.format(label, *_texts(*sizes, relative.translation.rmse, relative.rotation.rmse))
        )
    return "\n".join(lines)


def _texts(*values: float) -> Sequence[str]:
    return ["n/a" if math.isnan(value) else f"{value:.4f}" for value in values]
