"""What joint adaptation believes about the noise, and why, in a few plain words."""

import numpy as np

from fnn_ekf_ros.core.evidence import SCALES
from fnn_ekf_ros.core.joint import HYPOTHESES, JointReport

Values = tuple[tuple[str, str], ...]

NOISE_WORDS = {
    "forward": "wheels' way",
    "heading": "wheels' turn",
    "position": "fixes'",
    "yaw": "yaw's",
}
"""Whose noise a log scale is."""
LEAD_WORDS = {
    "start": "start: its noise explains the measurements as well",
    "settled": "settled: what was learned explains the measurements better",
    "fast": "fast: the noise seems to have just changed",
    "slip": "slip: the wheels seem to slide",
}
"""Why a hypothesis about the noise leads."""


def belief_in_words(report: JointReport) -> Values:
    """Return how large a filter believes its noise to be, and which hypothesis leads.

    Args:
        report: of a single filter, without batch dimensions.

    Returns:
        Keys and values; the noise as factors of standard deviations against the start's.
    """
    factors = zip(SCALES, np.exp(0.5 * report.log_scale), strict=True)
    noise = ", ".join(f"{NOISE_WORDS[name]} noise x {factor:.2g}" for name, factor in factors)
    weights = zip(HYPOTHESES, report.weights, strict=True)
    return (
        ("believes", f"{noise} (std against the start)"),
        ("because", LEAD_WORDS[HYPOTHESES[int(np.argmax(report.weights))]]),
        ("weights", ", ".join(f"{name} {weight:.2f}" for name, weight in weights)),
    )
