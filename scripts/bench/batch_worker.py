# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Runs a batch of robots through a filter of the studies, of whichever commit it imports."""

from typing import Any

import numpy as np

from bench.robot import GEOMETRY, MEASUREMENT_STD, PERIOD_S, SLIP_STD, drive
from bench.workers import cpu_s, peak_mib, serve

MEASURED = np.array([True, True, True, False])
"""As in the studies: fixes and a compass, no yaw of the fixes."""
SEED = 1
"""Seed of the recording, fixed: every run measures the same work."""


def measure(name: str, robots: int, steps: int, repeats: int = 1) -> dict[str, Any]:
    """Return the CPU time of a run and step [us] and the largest memory so far [MiB].

    Args:
        name: the filter's, as `study --filters` knows it.
        robots: runs in the batch.
        steps: periods.
        repeats: how often the batch is run for one number.
    """
    from fnn_ekf_ros.parameters.localizer import LocalizerParameters
    from fnn_ekf_ros.study.filters import study_filters
    from fnn_ekf_ros.study.recording import Recording, Start

    drove = drive(steps, robots, PERIOD_S, SEED)
    Q, R = np.square(SLIP_STD), np.square(MEASUREMENT_STD)
    recording = Recording(
        period_s=PERIOD_S,
        truth=drove.truth,
        control=drove.control,
        measurement=drove.measurement,
        available=np.tile(MEASURED, (steps, robots, 1)),
        process_noise=np.tile(Q, (steps, 1)),
        measurement_noise=np.tile(R, (steps, 1)),
    )
    start = Start(
        mean=drove.truth[0],
        covariance=np.broadcast_to(np.diag(R[:3]), (robots, 3, 3)),
        process_noise=np.broadcast_to(Q, (robots, 2)),
        measurement_noise=np.broadcast_to(R, (robots, 4)),
    )
    run = study_filters(LocalizerParameters(**GEOMETRY))[name].run
    began = cpu_s()
    for _ in range(repeats):
        track = run(recording, start)
    took = cpu_s() - began
    if not np.all(np.isfinite(track.mean)):
        raise ValueError(f"{name}: a mean is not finite")
    return {
        "us": 1e6 * took / (repeats * robots * steps),
        "peak_mib": peak_mib(),
        "last": track.mean[-1, 0].tolist(),
    }


if __name__ == "__main__":
    serve(measure)
