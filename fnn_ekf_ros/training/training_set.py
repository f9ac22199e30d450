"""The crisp training set {(D_k, dR_k)} of eq. 23, from simulated robots whose noise is known.

The paper does not say where its training set came from. Here, robots drive the paper's
simulations 1 and 2 and are localized by an EKF that is told the right Q, and an R that is held
at a value which for half of them is right, for the others wrong by a factor between 1/25 and 25
in variance (evenly in its logarithm, each row by its own). After each step

    D = S - C_hat               what the network will see                       (14)
    dR = STEP_SHARE (true R - assumed R)    what it ought to answer

are a pair. With a share of 0.25 a wrong R would be twice as close after 3 steps, and ten times
after 8. C_hat is a mean of N innovations: D scatters also where R is right, by about
sqrt(2 / N) S. What the network learns from such pairs is the mean E[dR | D]: far off it follows
D, and where D may well be chance it does little.

All three rows share one network, so each is divided by its own scale: the spread of D in robots
whose R is right. While learning dR counts in `STEP_SHARE` scales, so that far off both sides have
the same size. Pairs are picked evenly over D, which leaves E[dR | D] as it is and keeps the many
similar ones from drowning the few that differ.
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
from fnn_ekf_ros.pipeline.configure import filter_model
from fnn_ekf_ros.study.blocks import block_epochs, block_start
from fnn_ekf_ros.study.recording import Recording, Start
from fnn_ekf_ros.study.scenarios import NOMINAL, record

PATHS = ("sim1", "sim2")
RUNS = 120
"""Robots on each path."""
STEPS = 240
"""Steps of each robot."""
WRONG_BY = 25.0
"""Assumed R of the robots that are told a wrong one: up to so many times too small or large."""
RIGHT_SHARE = 0.5
"""Part of the robots that are told the right R."""
STEP_SHARE = 0.25
"""Part of the way to the true R that the network is asked to go in one step."""
FARTHEST = 20.0
"""Pairs with a D beyond so many scales are left out: the network is linear there."""
FINEST = 1.0
"""Intervals of D over which pairs are even widen in proportion to D beyond so many scales."""
INTERVALS = 20
PAIRS_PER_INTERVAL = 60
"""At most; there are hardly robots with a D so far below 0."""

_ROWS = (Row.X, Row.Y, Row.COMPASS_YAW)
_POSITION, _YAW = slice(0, 2), slice(2, 3)


class Observations(NamedTuple):
    """What filters with known noise saw, row by row: x, y, compass yaw (m^2, m^2, rad^2).

    Attributes:
        mismatch: `(n, 3)` D.
        wanted_change: `(n, 3)` dR.
        settled: `(n, 3)` whether R was right and the window full.
    """

    mismatch: FloatArray
    wanted_change: FloatArray
    settled: BoolArray


class TrainingSet(NamedTuple):
    """Pairs of all rows, each divided by its row's scale.

    Attributes:
        mismatch: `(k,)` D [scales].
        wanted_change: `(k,)` dR [`STEP_SHARE` scales].
        position_scale: spread of D where R is right, rows x and y [m^2].
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
        rng: source of everything random.
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
    """Run filters with the right Q and R that are held, right or wrong, over a recording.

    Args:
        recording: of n robots with constant noise.
        window_length: N of eq. 13.
        rng: source of the assumed R and of the start's error.
    """
    runs = recording.truth.shape[1]
    R = recording.measurement_noise[0]
    right = rng.random((runs, MEASUREMENT_SIZE)) < RIGHT_SHARE
    wrong_by = WRONG_BY ** rng.uniform(-1.0, 1.0, (runs, MEASUREMENT_SIZE))
    assumed = R * np.where(right, 1.0, wrong_by)
    first = R[[*_ROWS]]
    mean = recording.truth[0] + np.sqrt(first) * rng.standard_normal((runs, len(first)))
    start = Start(mean, np.diag(first), recording.process_noise[0], assumed)

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
    return Observations(mismatch, change, settled)


def pick(seen: Observations, rng: np.random.Generator) -> TrainingSet:
    """Scale the rows and pick pairs evenly over D.

    Args:
        seen: at least one row of each kind settled.
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
    return TrainingSet(mismatch[picked], wanted[picked], position, yaw)


def _holding_filter(window_length: int) -> FilterModel:
    """Return a filter that compares S with the innovations and changes nothing."""
    robot = LocalizerParameters(
        wheel_radius=WHEEL_RADIUS,
        wheel_separation=WHEEL_SEPARATION,
        encoder_counts_per_revolution=ENCODER_COUNTS_PER_REVOLUTION,
        adaptation="none",
        innovation_window=window_length,
        compass_gate=0.0,  # every reading teaches: none is wild here, however wrong the start
        lrf_pose_gate=0.0,
    )
    return filter_model(robot, networks_for(robot))
