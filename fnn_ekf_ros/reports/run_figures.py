# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Pictures of a run over time: errors, innovations, noise, beliefs, diagnostics."""

from typing import Any

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.evaluation.intervals import chi_square_band
from fnn_ekf_ros.evaluation.matching import Matched
from fnn_ekf_ros.recordings.run_record import Noise, RunRecord
from fnn_ekf_ros.reports.drawing import (
    Clock,
    curve,
    dots,
    finished,
    legend_above,
    limit_to_usual,
    plain_log,
)
from fnn_ekf_ros.reports.pictures import new_figure, shown_text
from fnn_ekf_ros.reports.plots import SIGMAS, claimed, credible
from fnn_ekf_ros.reports.svg import COLORS, WIDTH, panels, styled, svg_text
from fnn_ekf_ros.reports.thinning import extremes

INNOVATION_LIMIT = 6.0
"""Height of the axes of standardized innovations; larger ones are drawn at the edge."""
WINDOW = 50
"""Number of readings of the moving mean of NIS."""
LONG_CLAIM = 0.8
"""Share of the time whose band has to fit into the picture of the errors: at the start it may be
so wide that the errors were a line."""
WIDE = 8.0
"""Factor between the largest and the smallest value from which an axis is logarithmic."""
ROWS = {Row.X: "fix x", Row.Y: "fix y", Row.LRF_YAW: "fix yaw", Row.COMPASS_YAW: "compass"}
"""Names of the rows, in the order of the panels."""
LEVEL_COLORS = ("ok", "warn", "bad", "bad")
"""Colors of the levels of a status: OK, WARN, ERROR, STALE."""
LEVEL_HEIGHTS = (0.3, 0.62, 0.9, 0.9)
"""Heights of the bars of these levels, of the room between two statuses: seen without color,
too."""


def error_figure(matched: Matched, clock: Clock) -> str:
    """Draw the errors over time with the band of two standard deviations."""
    errors, time = matched.errors(), clock(matched.time_ns)
    names = ("x [m]", "y [m]", "yaw [rad]")
    shown = [axis for axis in range(3) if np.any(np.isfinite(errors[:, axis]))]
    with styled():
        figure, all_axes = panels(len(shown), 1.2)
        for axes, axis in zip(all_axes, shown, strict=True):
            band = claimed(matched.covariance, axis)
            kept = extremes(errors[:, axis], band)
            axes.fill_between(
                time[kept], -band[kept], band[kept], color=COLORS["estimate"], alpha=0.22, lw=0.0,
                label="2 sigma claimed",
            )  # fmt: skip
            for side in (-1.0, 1.0):  # seen above errors that fill the band, too
                axes.plot(time[kept], side * band[kept], color=COLORS["second"], lw=0.6, zorder=3.0)
            axes.axhline(0.0, color=COLORS["line"], lw=0.8)
            axes.plot(time[kept], errors[kept, axis], color=COLORS["estimate"], lw=0.9,
                      label="odom - ground truth")  # fmt: skip
            axes.set_ylabel(names[axis])
            limit_to_usual(axes, errors[:, axis], band[band <= np.quantile(band, LONG_CLAIM)])
        return finished(figure, all_axes, clock, "errors over time")


def claim_figure(run: RunRecord, clock: Clock) -> str:
    """Draw the standard deviations that odom claims over time."""
    time = clock(run.track.time_ns)
    with styled():
        figure, all_axes = panels(2, 1.2)
        for axes, parts, unit in ((all_axes[0], (0, 1), "[m]"), (all_axes[1], (2,), "[rad]")):
            for axis, color in zip(parts, ("estimate", "second"), strict=False):
                std = np.sqrt(credible(run.track.covariance[:, axis, axis]))
                kept = extremes(std)
                axes.plot(
                    time[kept],
                    std[kept],
                    color=COLORS[color],
                    lw=1.0,
                    label="xy"[axis] if axis < 2 else "yaw",
                )
            axes.set_ylabel(f"std {unit}")
            axes.set_ylim(bottom=0.0)
            legend_above(axes)
        all_axes[-1].set_xlabel(clock.label)
        return svg_text(figure, "claimed standard deviations over time")


def innovation_figure(noise: Noise, clock: Clock) -> str:
    """Draw innovations over their standard deviations, and the moving mean of NIS; or nothing."""
    rows = [row for row in ROWS if np.sum(noise.measured(row)) > 1]
    if not rows:
        return ""
    time = clock(noise.time_ns)
    with styled():
        figure, all_axes = panels(len(rows) + 1, 1.0)
        for axes, row in zip(all_axes, rows, strict=False):
            flag = "rejected_compass" if row is Row.COMPASS_YAW else "rejected_lrf_pose"
            z, out = noise.standardized(row), noise.get(flag) > 0.0
            z = np.clip(
                np.where(noise.measured(row), z, np.nan), -INNOVATION_LIMIT, INNOVATION_LIMIT
            )
            axes.axhspan(-2.0, 2.0, color=COLORS["estimate"], alpha=0.16, lw=0.0)
            dots(axes, time, np.where(out, np.nan, z), "estimate", "accepted")
            dots(axes, time, np.where(out, z, np.nan), "bad", "rejected")
            axes.set(ylabel=ROWS[row], ylim=(-INNOVATION_LIMIT * 1.08, INNOVATION_LIMIT * 1.08))
        _draw_nis(all_axes[-1], noise, time)
        return finished(figure, all_axes, clock, "innovations and NIS over time")


def noise_figure(noise: Noise, clock: Clock) -> str:
    """Draw the noise that the localizer found, as standard deviations."""
    groups = (
        ("[m]", (("measurement_noise_x", "fix x", "estimate"),
                 ("measurement_noise_y", "fix y", "third"),
                 ("process_noise_forward", "distance", "second"))),
        ("[rad]", (("measurement_noise_compass_yaw", "compass", "estimate"),
                   ("measurement_noise_lrf_yaw", "fix yaw", "third"),
                   ("process_noise_heading", "rotation", "second"))),
    )  # fmt: skip
    time = clock(noise.time_ns)
    with styled():
        figure, all_axes = panels(2, 1.35)
        for axes, (unit, fields) in zip(all_axes, groups, strict=True):
            for place, (field, name, color) in enumerate(fields):
                std = np.sqrt(credible(noise.get(field)))
                kept = extremes(std)
                dashes = "--" if place == 1 else "-"  # both of two alike are seen
                axes.plot(time[kept], std[kept], dashes, color=COLORS[color], lw=1.2, label=name)
            axes.set_yscale("log")
            plain_log(axes)
            axes.set_ylabel(f"std {unit}")
            legend_above(axes)
        all_axes[-1].set_xlabel(clock.label)
        return svg_text(figure, "noise found over time")


def lasting_figure(noise: Noise, clock: Clock) -> str:
    """Draw what is believed of errors that last; nothing if they were not followed."""
    share = lasting_share(noise)
    if not np.any(noise.get("lasting_time_constant")):
        return ""
    time = clock(noise.time_ns)
    with styled():
        figure, all_axes = panels(3, 1.05)
        curve(all_axes[0], time, share, "estimate", "belief")
        all_axes[0].set(ylabel="belief", ylim=(-0.03, 1.05))
        curve(all_axes[1], time, noise.get("lasting_fix_std"), "estimate", "fixes [m]")
        curve(all_axes[1], time, noise.get("lasting_yaw_std"), "second", "yaw [rad]")
        all_axes[1].set_ylabel("std")
        legend_above(all_axes[1])
        offset, std = noise.get("compass_offset"), noise.get("compass_offset_std")
        kept = extremes(offset, std)
        all_axes[2].fill_between(
            time[kept], (offset - SIGMAS * std)[kept], (offset + SIGMAS * std)[kept],
            color=COLORS["estimate"], alpha=0.22, lw=0.0,
        )  # fmt: skip
        curve(all_axes[2], time, offset, "estimate", "offset")
        all_axes[2].axhline(0.0, color=COLORS["line"], lw=0.8)
        settled = (np.abs(offset) + SIGMAS * std)[len(std) // 20 :]
        reach = 1.2 * float(np.max(settled, initial=1e-3))
        all_axes[2].set(ylabel="offset [rad]", ylim=(-reach, reach))
        all_axes[-1].set_xlabel(clock.label)
        return svg_text(figure, "beliefs about lasting errors over time")


def diagnostics_figure(run: RunRecord, clock: Clock) -> str:
    """Draw the level of each status over time; nothing without statuses."""
    if not run.statuses:
        return ""
    with styled():
        figure = new_figure(WIDTH, 0.75 + 0.3 * len(run.statuses))
        axes = figure.subplots()
        for place, reports in enumerate(run.statuses.values()):
            times = clock(np.array([report.time_ns for report in reports]))
            levels = np.array([report.level for report in reports])
            starts = np.flatnonzero(np.diff(levels, prepend=-1))
            ends = np.append(times[starts[1:]], times[-1])
            for start, end in zip(starts, ends, strict=True):
                level = min(int(levels[start]), len(LEVEL_COLORS) - 1)
                axes.barh(
                    place, end - times[start], left=times[start], height=LEVEL_HEIGHTS[level],
                    color=COLORS[LEVEL_COLORS[level]], lw=0.0,
                )  # fmt: skip
        axes.set_yticks(range(len(run.statuses)), [shown_text(name) for name in run.statuses])
        axes.invert_yaxis()
        axes.set_xlabel(clock.label)
        axes.tick_params(axis="y", length=0)
        return svg_text(figure, "diagnostics over time")


def lasting_share(noise: Noise) -> FloatArray:
    """Return the weight of all members with lasting errors `(n,)`, 0 to 1."""
    weights = [values for name, values in noise.values.items()
               if name.startswith("weight_fix_") and name != "weight_fix_0"]  # fmt: skip
    return np.sum(weights, axis=0) if weights else np.zeros(len(noise.time_ns))


def _draw_nis(axes: Any, noise: Noise, time: FloatArray) -> None:
    """Draw the moving mean of NIS over its degrees of freedom, and its band where it is honest."""
    nis, dof = noise.get("nis"), noise.get("degrees_of_freedom")
    used = np.flatnonzero((dof > 0.0) & np.isfinite(nis))
    axes.axhline(1.0, color=COLORS["line"], lw=0.8)
    axes.set_ylabel("NIS / dof")
    width = min(WINDOW, max(len(used) // 4, 1))
    if len(used) < 2:
        return
    ends = np.arange(width, len(used) + 1)
    sums = [np.concatenate([[0.0], np.cumsum(values[used])]) for values in (nis, dof)]
    total, degrees = (s[ends] - s[ends - width] for s in sums)
    middle = time[used[ends - 1 - width // 2]]
    mean = total / degrees
    low, high = chi_square_band(degrees)
    kept = extremes(mean)
    axes.fill_between(
        middle[kept], low[kept], high[kept], color=COLORS["estimate"], alpha=0.16, lw=0.0
    )
    axes.plot(middle[kept], mean[kept], color=COLORS["estimate"], lw=1.0)
    if np.max(mean) > WIDE * np.min(mean):
        axes.set_yscale("log")
        plain_log(axes)
