# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Captions of a run's pictures: what to see in them, with the numbers of this run."""

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray, Row
from fnn_ekf_ros.evaluation.evaluation import Evaluation
from fnn_ekf_ros.evaluation.matching import Matched
from fnn_ekf_ros.recordings.run_record import Noise, RunRecord
from fnn_ekf_ros.reports.drawing import Clock
from fnn_ekf_ros.reports.plots import claimed
from fnn_ekf_ros.reports.run_figures import ROWS, WINDOW, lasting_share

INSIDE = 0.954
"""Share of Gaussian errors within two standard deviations."""
BELIEVED = 0.5
"""Weight of lasting errors from which they are believed rather than not."""


def map_caption(found: Evaluation, clock: Clock) -> str:
    """Tell what the map shows."""
    said = "Odom with ellipses of 2 sigma that it claims; where none are seen they are too small."
    if found.truth is None:
        return f"{said} The recording has no ground truth."
    position = np.hypot(*found.truth.matched.errors()[:, :2].T)
    worst = int(np.argmax(position))
    when = time_text(clock, found.truth.matched.time_ns[worst])
    said += f" Odom is off by {position[worst]:.3g} m at most, at {when}."
    if found.truth.alignment != "none":
        said += f" Odom is drawn as --align {found.truth.alignment} moved it."
    return said


def error_caption(matched: Matched) -> str:
    """Tell how often errors are inside of the band."""
    errors, said = matched.errors(), []
    for axis, name in enumerate(("x", "y", "yaw")):
        band = claimed(matched.covariance, axis)
        known = np.isfinite(errors[:, axis]) & np.isfinite(band)
        if np.any(known):
            inside = np.mean(np.abs(errors[known, axis]) <= band[known])
            said.append(f"{name} {inside:.0%}")
    rule = f"An honest filter is inside of its band {INSIDE:.0%} of the time"
    if not said:
        return f"{rule}; this one claims nothing."
    return (
        f"{rule}; this one is for {', '.join(said)}. Errors that keep their sign for long are not "
        "noise: a shifted map, a delay or a yaw that is off."
    )


def innovation_caption(noise: Noise) -> str:
    """Tell how many innovations are outside of two standard deviations."""
    said = []
    for row, name in ROWS.items():
        z = noise.standardized(row)[noise.measured(row)]
        if len(z) > 1:
            said.append(f"{name} {np.mean(np.abs(z) > 2.0):.1%}")
    return (
        "Readings minus predictions, over the standard deviation that was expected, rejected ones "
        f"in red. Outside of 2 should be {1.0 - INSIDE:.1%}; here: {', '.join(said)}. The last "
        f"panel is the mean NIS of {WINDOW} periods over its degrees of freedom with the 95 % band "
        "of white innovations: above it the filter is surprised, below it expects more noise than "
        "there is."
    )


def noise_caption(noise: Noise) -> str:
    """Tell from where to where the noise moved."""
    parts = []
    for field, name, unit in (
        ("measurement_noise_x", "fix x", "m"), ("process_noise_forward", "distance", "m"),
        ("measurement_noise_compass_yaw", "compass", "rad"),
        ("process_noise_heading", "rotation", "rad"),
    ):  # fmt: skip
        std = np.sqrt(np.maximum(noise.get(field), 0.0))
        parts.append(f"{name} {std[0]:.3g} to {std[-1]:.3g} {unit}")
    return (
        "Standard deviations in use, of the wheels for 375 ms; from the start to the end: "
        f"{', '.join(parts)}. Values that still move at the end are not settled."
    )


def lasting_caption(noise: Noise) -> str:
    """Tell what is believed of lasting errors in the end."""
    share = lasting_share(noise)
    word = "are believed" if share[-1] > BELIEVED else "are not believed"
    text = (
        "Weight of the hypotheses that errors last, how large they are, and the offset of the "
        f"compass with 2 sigma. In the end lasting errors {word} (weight {share[-1]:.2f}"
    )
    if share[-1] > BELIEVED:
        text += (
            f"; fixes {noise.get('lasting_fix_std')[-1]:.2g} m for about "
            f"{noise.get('lasting_time_constant')[-1]:.0f} s"
        )
    offset, std = noise.get("compass_offset")[-1], noise.get("compass_offset_std")[-1]
    text += f"); the offset is {offset:.3f} +- {2.0 * std:.3f} rad"
    if np.any(noise.measured(Row.COMPASS_YAW)):
        used = "used" if noise.get("compass_offset_believed")[-1] > 0.0 else "not used"
        text += f" and {used}"
    return f"{text}."


def diagnostics_caption(run: RunRecord) -> str:
    """Tell how long each status was not OK."""
    parts = []
    for name, reports in run.statuses.items():
        bad = float(np.mean([report.level > 0 for report in reports]))
        if bad > 0.0:
            parts.append(f"{name} {bad:.1%}")
    if not parts:
        return "All statuses were OK all the time."
    return (
        "Thin bars are OK, high ones WARN or ERROR. Share of the reports that were not OK: "
        f"{', '.join(parts)}."
    )


def claim_caption(track_std: FloatArray) -> str:
    """Tell how sure odom was."""
    return (
        f"How sure odom says it is: the median standard deviation of x is "
        f"{np.median(track_std):.3g} m, the largest {np.max(track_std):.3g} m."
    )


def time_text(clock: Clock, time_ns: int) -> str:
    """Return a time [ns] as the pictures' axes have it."""
    unit = "min" if clock.unit_s > 1.0 else "s"
    return f"{max(time_ns - clock.start_ns, 0) * 1e-9 / clock.unit_s:.1f} {unit}"
