# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The noise that joint adaptation has estimated, and the reason, in a few plain words."""

import numpy as np

from fnn_ekf_ros.core.evidence import SCALES
from fnn_ekf_ros.core.joint_state import HYPOTHESES, JointReport

Values = tuple[tuple[str, str], ...]
"""Keys and values of a status."""

NOISE_WORDS = {
    "forward": "distance",
    "heading": "rotation",
    "position": "fixes",
    "yaw": "yaw",
}
"""The noise that a log scale belongs to."""
LEAD_WORDS = {
    "start": "start: the configured noise explains the measurements as well",
    "settled": "settled: the learned noise explains the measurements better",
    "fast": "fast: the noise seems to have changed just now",
    "slip": "slip: the wheels seem to slip",
}
"""The reason for which a hypothesis about the noise leads."""


def noise_in_words(report: JointReport) -> Values:
    """Return the estimated noise of a filter, and the hypothesis that leads.

    Args:
        report: of a single filter, without batch dimensions.

    Returns:
        Keys and values; the noise as factors of standard deviations against the configured ones.
    """
    factors = zip(SCALES, np.exp(0.5 * report.log_scale), strict=True)
    noise = ", ".join(f"{NOISE_WORDS[name]} x {factor:.2g}" for name, factor in factors)
    weights = zip(HYPOTHESES, report.weights, strict=True)
    return (
        ("estimated noise (std against the configured one)", noise),
        ("reason", LEAD_WORDS[HYPOTHESES[int(np.argmax(report.weights))]]),
        ("weights", ", ".join(f"{name} {weight:.2f}" for name, weight in weights)),
    )
