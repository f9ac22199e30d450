# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Cases of `pinned`: filters of the studies on simulated recordings."""

import functools
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fnn_ekf_ros.core.arrays import Row
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.study.filters import study_filters
from fnn_ekf_ros.study.recording import Recording, Start
from fnn_ekf_ros.study.scenarios import (
    NOMINAL,
    NOMINAL_MEASUREMENT_NOISE,
    Drive,
    Scenario,
    drive,
    sense,
)
from fnn_ekf_ros.study.starts import CORNERS, RIGHT, starts

STEPS, RUNS, SEED = 150, 2, 11
CARRIED = 60
"""The step after which the robot is carried, where other faults begin as well."""
KEPT_STEPS = (5, 25, 50, CARRIED + 5, *range(75, STEPS + 1, 25))
"""Steps after which results of a study are kept."""
UNSTABLE = ("rq_published", "rq_centroid")
"""With the paper's own sets, mode rq lets a difference grow tenfold in about ten steps: one of
1e-14 is beyond 1e-9 after fifty. Only the first steps of these filters can be compared."""
FIRST_STEPS = (5, 10, 15, 20, 25, 30)
"""Steps after which their results are kept."""
UPPER = np.triu_indices(3)

WHITE = {"lasting_errors": False}
"""Parameters of all filters: what mode joint learns is pinned, without errors that last."""

Records = NDArray[Any]
"""A structured array; the first field says when."""


class StudyCase(NamedTuple):
    """Recordings and starts, and the filters that are run on them.

    Attributes:
        filters: their names.
        path: that the robot drives.
        scenario: what goes wrong.
        carried: by how much fixes and truth are displaced after step `CARRIED`, x and y [m].
        start_error: of the start pose (m, m, rad).
        parameters: of the filters, where they differ from the study's.
    """

    filters: tuple[str, ...]
    path: str = "sim1"
    scenario: Scenario = NOMINAL
    carried: float = 0.0
    start_error: tuple[float, float, float] = (0.0, 0.0, 0.0)
    parameters: Mapping[str, Any] = {}


ALL = (
    "ekf", "ekf_gated", "oracle", "joint", "rq_published", "rq_trained", "r_published",
    "q_trained", "rq_centroid",
)  # fmt: skip
GATED = ("ekf_gated", "joint")
STUDIES = {
    "sim1": StudyCase(ALL),
    "sim2": StudyCase(ALL, path="sim2"),
    "slip": StudyCase(("oracle", "joint", "rq_trained"), scenario=Scenario(process_scale=100.0)),
    "outliers": StudyCase(GATED, scenario=Scenario(outlier_share=0.05, outlier_scale=10.0)),
    "compass_bias": StudyCase(GATED, scenario=Scenario(compass_bias=1.5)),
    "compass_lost": StudyCase(
        ("ekf_gated", "rq_trained"), scenario=Scenario(lost=(Row.COMPASS_YAW,))
    ),
    "wrong_start": StudyCase(GATED, start_error=(3.0, -2.0, 1.5)),
    "carried": StudyCase(GATED, carried=5.0),
    "motion_of_the_paper": StudyCase(("ekf", "rq_trained"), parameters={"motion_model": "paper"}),
    "short_window": StudyCase(UNSTABLE, parameters={"innovation_window": 8}),
}


@functools.cache
def _driven(path: str, process_scale: float) -> Drive:
    scenario = Scenario(process_scale=process_scale)
    rng = np.random.default_rng(SEED)
    return drive(FakeRobotParameters(path=path), scenario, STEPS, RUNS, rng)


@functools.cache
def _recording(name: str) -> Recording:
    case = STUDIES[name]
    robot = FakeRobotParameters(path=case.path)
    driven = _driven(case.path, case.scenario.process_scale)
    recording = sense(robot, case.scenario, driven, np.random.default_rng(SEED + 1))
    truth, measurement = recording.truth.copy(), recording.measurement.copy()
    truth[CARRIED + 1 :, :, :2] += case.carried
    measurement[CARRIED:, :, [Row.X, Row.Y]] += case.carried
    return recording._replace(truth=truth, measurement=measurement)


def _start(case: StudyCase, recording: Recording) -> Start:
    """Return the right start, and the four with Q and R both wrong by 25."""
    Q = np.square(FakeRobotParameters(path=case.path).slip())
    rng = np.random.default_rng(SEED + 2)
    start = starts(recording, Q, NOMINAL_MEASUREMENT_NOISE, (RIGHT, *CORNERS), rng)
    return start._replace(mean=start.mean + np.array(case.start_error))


def study_results(name: str, filter_name: str) -> dict[str, Records]:
    """Return mean, covariance and NIS after the steps that are kept."""
    case = STUDIES[name]
    matching = matching_localizer(FakeRobotParameters(path=case.path))
    changes = WHITE | dict(case.parameters)
    filters = study_filters(build(LocalizerParameters, asdict(matching) | changes))
    recording = _recording(name)
    start = _start(case, recording)
    if filter_name == "oracle":  # knows the noise: all its starts are the same
        start = Start(*(array[:1] for array in start))
    track = filters[filter_name].run(recording, start)
    rows = []
    for step in FIRST_STEPS if filter_name in UNSTABLE else KEPT_STEPS:
        mean, covariance, nis = (array[step - 1] for array in track[:3])
        rows.append((step, mean, covariance[..., *UPPER], nis))
    batch = track.nis.shape[1:]
    track_dtype = [
        ("step", "i8"),
        ("mean", "f8", (*batch, 3)),
        ("covariance", "f8", (*batch, 6)),
        ("nis", "f8", batch),
    ]
    return {"track": np.array(rows, track_dtype)}
