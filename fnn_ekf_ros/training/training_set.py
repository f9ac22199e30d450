# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The crisp training set {(D_k, dR_k)} of eq. 23, from simulated robots whose noise is known.

The paper does not describe the origin of its training set. Here, robots drive the paper's
simulations 1 and 2 and are localized by an EKF with the right Q and a constant R. The assumed R is
right for half of the robots; for the others each row is wrong by a factor between 1/25 and 25 in
variance, uniform in its logarithm. Each step gives a pair:

    D = S - C_hat                           the network's input                 (14)
    dR = STEP_SHARE (true R - assumed R)    its target output

With a share of 0.25 the error of a wrong R is halved after 3 steps and a tenth after 8. C_hat is a
mean of N innovations, so D scatters by about sqrt(2 / N) S even where R is right. From such pairs
the network learns the mean E[dR | D]: a large D gives a proportional change, a D that may be chance
a small one.

All three rows share one network, so each is divided by its own scale, the spread of D in robots
whose R is right. During learning dR is given in units of `STEP_SHARE` scales, so that inputs and
targets have the same size far from the right R. Pairs are picked uniformly over D: this leaves
E[dR | D] as it is, and many similar pairs do not outweigh few different ones.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import SMALLEST_WINDOW_SHARE
from fnn_ekf_ros.core.arrays import MEASUREMENT_SIZE, BoolArray, FloatArray, Row, components_last
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.state import FilterModel, start_filter
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.paper import (
    ENCODER_COUNTS_PER_REVOLUTION,
    WHEEL_RADIUS,
    WHEEL_SEPARATION,
)
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.study.blocks import block_epochs, block_start
from fnn_ekf_ros.study.recording import Recording, Start
from fnn_ekf_ros.study.scenarios import NOMINAL, record
from fnn_ekf_ros.timeline.filter_model import filter_model

PATHS = ("sim1", "sim2")
"""Paths of the paper's two simulations."""
RUNS = 120
"""Robots on each path."""
STEPS = 240
"""Steps of each robot, 90 s: several times the window of 45 innovations."""
WRONG_BY = 25.0
"""Largest factor in variance by which a wrong assumed R is too small or too large, as in the
studies."""
RIGHT_SHARE = 0.5
"""Part of the robots whose assumed R is right."""
STEP_SHARE = 0.25
"""Part of the error of R that one step is to remove."""
FARTHEST = 20.0
"""Largest |D| of the pairs [scales]: beyond it the network is linear."""
FINEST = 1.0
"""|D| beyond which the intervals for picking pairs widen in proportion to D [scales]."""
INTERVALS = 20
"""Intervals of D in which pairs are picked."""
PAIRS_PER_INTERVAL = 60
"""Largest number of pairs picked in an interval; those of a D far below 0 have fewer."""

_ROWS = (Row.X, Row.Y, Row.COMPASS_YAW)
"""Rows that the simulated sensors measure."""
_POSITION, _YAW = slice(0, 2), slice(2, 3)
"""The columns of `_ROWS` that are positions, and the one that is a yaw."""


class Observations(NamedTuple):
    """Mismatches of filters with known noise; columns x, y, compass yaw (m^2, m^2, rad^2).

    Attributes:
        mismatch: `(n, 3)` D.
        wanted_change: `(n, 3)` target dR.
        settled: `(n, 3)` whether R was right and the window full.
    """

    mismatch: FloatArray
    wanted_change: FloatArray
    settled: BoolArray


class TrainingSet(NamedTuple):
    """Pairs of all rows, each divided by its row's scale.

    Attributes:
        mismatch: `(k,)` D [scales].
        wanted_change: `(k,)` target dR [`STEP_SHARE` scales].
        position_scale: standard deviation of D where R is right, rows x and y [m^2].
        yaw_scale: the same of the compass [rad^2].
    """

    mismatch: FloatArray
    wanted_change: FloatArray
    position_scale: float
    yaw_scale: float


def make_training_set(window_length: int, rng: np.random.Generator) -> TrainingSet:
    """Return the training set; it takes some seconds.

    Args:
        window_length: N of eq. 13.
        rng: source of all random numbers.
    """
    simulation_rng, start_rng, pick_rng = rng.spawn(3)
    seen = [
        observe(
            record(build(FakeRobotParameters, {"path": path}), NOMINAL, STEPS, RUNS, path_rng),
            window_length,
            start_rng,
        )
        for path, path_rng in zip(PATHS, simulation_rng.spawn(len(PATHS)), strict=True)
    ]
    return pick(Observations(*map(np.concatenate, zip(*seen, strict=True))), pick_rng)


def observe(recording: Recording, window_length: int, rng: np.random.Generator) -> Observations:
    """Run filters with the right Q and a constant R, right or wrong, over a recording.

    Args:
        recording: of n robots with constant noise.
        window_length: N of eq. 13.
        rng: source of the assumed R and of the errors of the first pose.
    """
    runs = recording.truth.shape[1]
    R = recording.measurement_noise[0]
    right = rng.random((runs, MEASUREMENT_SIZE)) < RIGHT_SHARE
    wrong_by = WRONG_BY ** rng.uniform(-1.0, 1.0, (runs, MEASUREMENT_SIZE))
    assumed = R * np.where(right, 1.0, wrong_by)
    first = R[[*_ROWS]]
    mean = recording.truth[0] + np.sqrt(first) * rng.standard_normal((runs, len(first)))
    start = Start(
        mean=mean,
        covariance=np.diag(first),
        process_noise=recording.process_noise[0],
        measurement_noise=assumed,
    )

    model = _holding_filter(window_length)
    state = start_filter(model, *block_start(recording, start)[1:])
    unready = int(np.ceil(SMALLEST_WINDOW_SHARE * window_length)) - 1
    wanted = STEP_SHARE * (R - assumed)
    seen = []
    for t, epoch in enumerate(block_epochs(recording, start)):
        state, result = step(model, state, (epoch,))
        if t >= unready:
            full = components_last(state.window.counts) >= window_length
            seen.append((components_last(result.mismatch), wanted, right & full))
    mismatch, change, settled = (np.concatenate(part)[:, _ROWS] for part in zip(*seen, strict=True))
    return Observations(mismatch=mismatch, wanted_change=change, settled=settled)


def pick(seen: Observations, rng: np.random.Generator) -> TrainingSet:
    """Scale the rows and pick pairs uniformly over D.

    Args:
        seen: with settled positions and yaws.
        rng: source of the choice.
    """
    position, yaw = (
        float(np.std(seen.mismatch[:, rows][seen.settled[:, rows]])) for rows in (_POSITION, _YAW)
    )
    scale = np.array([position, position, yaw])
    mismatch = (seen.mismatch / scale).ravel()
    wanted = (seen.wanted_change / (STEP_SHARE * scale)).ravel()
    widest = np.arcsinh(FARTHEST / FINEST)
    edges = FINEST * np.sinh(np.linspace(-widest, widest, INTERVALS + 1))
    interval = np.digitize(mismatch, edges)
    picked = np.concatenate(
        [
            rng.permutation(np.flatnonzero(interval == number))[:PAIRS_PER_INTERVAL]
            for number in range(1, INTERVALS + 1)
        ]
    )
    return TrainingSet(
        mismatch=mismatch[picked],
        wanted_change=wanted[picked],
        position_scale=position,
        yaw_scale=yaw,
    )


def _holding_filter(window_length: int) -> FilterModel:
    """Return a filter that computes D and adapts nothing."""
    robot = LocalizerParameters(
        wheel_radius=WHEEL_RADIUS,
        wheel_separation=WHEEL_SEPARATION,
        encoder_counts_per_revolution=ENCODER_COUNTS_PER_REVOLUTION,
        adaptation="none",
        innovation_window=window_length,
        compass_gate=0.0,  # all readings are used: there are no outliers, however wrong the start
        lrf_pose_gate=0.0,
    )
    return filter_model(robot, networks_for(robot))
