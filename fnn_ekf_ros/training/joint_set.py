# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The crisp training set {(u_k, dtheta_k)} of mode joint's network, from simulated robots.

Robots drive the paper's simulations 1 and 2 and are localized by mode joint. Their configured noise
is right, or wrong by a factor between 1/25 and 25 in variance, uniform in its logarithm, separately
for each of the four log scales theta. At each step at which the settled learner learns,

    u                               the change that the measurement indicates
    delta = theta* - theta          the change that would give the true noise

are known for every scale. The network's target is E[delta | u]: of all functions of u, it gives the
smallest mean square error of theta. A single u carries little information (delta scatters by 0.1 to
1 around a mean of 0.01 to 0.5), so a crisp pair is the mean over all steps with a u of similar
size, at least a few hundred.

How quickly noise should be learned depends on how quickly it changes. Robots with constant noise
alone give a slope of 0.7 near u = 0 and a network that notices slip late. Therefore one robot in
five has, in the third fifth of its drive, slip or sensors with `EVENT_SCALE` times the variance.
With these the slope is 0.9; that of the natural gradient is 1. (After a change the mean of delta
does not go to 0 with u, because the evidence comes late. No continuous odd function can follow
that.)

The output near 0 matters most, because 95 % of all |u| are below 0.1. A pair has the weight
1 / (|u| + FINEST), so that errors count relative to the output.

Two properties are imposed, not learned.

    odd     u and -u make one pair and its mirror image: f(0) = 0, and noise is increased as
            quickly as it is decreased. The settled learner forgets in 200 steps; a constant
            output of 0.001 would be balanced by the evidence only where theta is off by about 0.2.
    bounded a mean beyond `LARGEST_CHANGE` is clipped to it.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row, components_last
from fnn_ekf_ros.core.evidence import SCALE_COUNT
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.joint_filters import ROW_SCALE, SETTLED
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
from fnn_ekf_ros.study.scenarios import NOMINAL, Scenario, record
from fnn_ekf_ros.timeline.filter_model import filter_model
from fnn_ekf_ros.training.training_set import PATHS

RUNS = {"constant": 160, "slip": 20, "noisy sensors": 20}
"""Robots on each path, by their scenario."""
EVENT_SCALE = 25.0
"""Factor on the variance of the wheels, or of the fixes and the compass, during an event: five
times the standard deviation."""
SCENARIOS = {
    "constant": NOMINAL,
    "slip": Scenario(process_scale=EVENT_SCALE),
    "noisy sensors": Scenario(measurement_scale=EVENT_SCALE),
}
"""Events of the robots, by the names of `RUNS`."""
STEPS = 400
"""Steps of each robot, 150 s: after them a wrong start's noise has largely been learned."""
WRONG_BY = 25.0
"""Largest factor in variance by which the configured noise is too small or too large, as in the
studies."""
RIGHT_SHARE = 0.25
"""Part of the robots whose configured noise is right."""
LARGEST_CHANGE = 1.0
"""Largest target change per step [log variance], a factor of 2.7."""
FINEST = 0.05
"""|u| beyond which the intervals widen in proportion to it [log variance]."""
FARTHEST = 3.0
"""Largest |u| of the steps that are used [log variance]; there are hardly any beyond it."""
INTERVALS = 18
"""Intervals of |u|; each gives a pair."""
FEWEST_STEPS = 200
"""Fewest steps in an interval that gives a pair: the mean of fewer is too uncertain."""


class JointObservations(NamedTuple):
    """Steps of settled learners, with the right change; scales as in `evidence.SCALES`.

    Attributes:
        asked: `(n, 4)` u [log variance].
        wanted_change: `(n, 4)` delta before the step [log variance].
        right: `(n,)` whether the robot's configured noise was right.
    """

    asked: FloatArray
    wanted_change: FloatArray
    right: BoolArray


class JointTrainingSet(NamedTuple):
    """Crisp pairs in the order of u, each with its mirror image.

    Attributes:
        asked: `(k,)` u [log variance].
        wanted_change: `(k,)` target output of the network [log variance].
        weight: `(k,)` weights of the pairs; their sum is 1.
    """

    asked: FloatArray
    wanted_change: FloatArray
    weight: FloatArray


def make_joint_set(network: FuzzyNetwork, rng: np.random.Generator) -> JointTrainingSet:
    """Return the training set; it takes about half a minute.

    Args:
        network: mode joint's network while the pairs are made.
        rng: source of all random numbers.
    """
    seen = []
    for path, path_rng in zip(PATHS, rng.spawn(len(PATHS)), strict=True):
        robot = build(FakeRobotParameters, {"path": path})
        for name, runs in RUNS.items():
            simulation_rng, start_rng = path_rng.spawn(2)
            recording = record(robot, SCENARIOS[name], STEPS, runs, simulation_rng)
            seen.append(observe_joint(recording, network, start_rng))
    return average(JointObservations(*map(np.concatenate, zip(*seen, strict=True))))


def observe_joint(
    recording: Recording, network: FuzzyNetwork, rng: np.random.Generator
) -> JointObservations:
    """Run mode joint from right and wrong noise over a recording.

    Args:
        recording: of n robots; the noise of step 0 is the right configured noise.
        network: mode joint's network.
        rng: source of the configured noise and of the errors of the first pose.
    """
    runs = recording.truth.shape[1]
    right: BoolArray = np.asarray(rng.random(runs) < RIGHT_SHARE)
    wrong_by = WRONG_BY ** rng.uniform(-1.0, 1.0, (runs, SCALE_COUNT))
    assumed = np.where(right[:, None], 1.0, wrong_by)
    Q, R = recording.process_noise[0], recording.measurement_noise[0]
    first = R[:3]
    mean = recording.truth[0] + np.sqrt(first) * rng.standard_normal((runs, len(first)))

    start = Start(
        mean=mean,
        covariance=np.diag(first),
        process_noise=Q * assumed[:, :2],
        measurement_noise=R * assumed[:, ROW_SCALE],
    )

    model = _joint_filter(network)
    state = start_filter(model, *block_start(recording, start)[1:])
    true_scale = np.log(_of_scales(recording) / _of_scales(recording)[0])
    seen = []
    for t, epoch in enumerate(block_epochs(recording, start)):
        before = state.joint
        state, result = step(model, state, (epoch,))
        if before is None or result.joint is None:
            raise ValueError(f"mode {model.adaptation.mode.value}: expected mode joint")
        u = components_last(result.joint.explained)
        settled = components_last(before.log_scale[:, SETTLED])
        learned: BoolArray = np.asarray(np.any(u != 0.0, axis=-1))
        delta = true_scale[t] - np.log(assumed) - settled
        seen.append((u[learned], delta[learned], right[learned]))
    return JointObservations(*map(np.concatenate, zip(*seen, strict=True)))


def average(seen: JointObservations) -> JointTrainingSet:
    """Return a crisp pair for each interval of |u|, and its mirror image.

    Args:
        seen: steps of all scales, at least `FEWEST_STEPS` in one of the intervals.
    """
    size = np.abs(seen.asked).ravel()
    onward = (np.sign(seen.asked) * seen.wanted_change).ravel()
    edges = FINEST * np.sinh(np.linspace(0.0, np.arcsinh(FARTHEST / FINEST), INTERVALS + 1))
    interval = np.digitize(size, edges[1:])
    count, sizes, onwards = (
        np.bincount(interval, weight, minlength=INTERVALS + 1)[:INTERVALS]
        for weight in (None, size, onward)
    )
    enough = count >= FEWEST_STEPS
    u = sizes[enough] / count[enough]
    change = np.clip(onwards[enough] / count[enough], -LARGEST_CHANGE, LARGEST_CHANGE)
    weight = 1.0 / (u + FINEST)
    weight /= 2.0 * np.sum(weight)
    return JointTrainingSet(
        asked=np.concatenate([-u[::-1], u]),
        wanted_change=np.concatenate([-change[::-1], change]),
        weight=np.concatenate([weight[::-1], weight]),
    )


def _of_scales(recording: Recording) -> FloatArray:
    """Return the true variance of each log scale, `(T, 4)`."""
    R = recording.measurement_noise
    return np.concatenate(
        [recording.process_noise, R[:, [Row.X, Row.COMPASS_YAW]]],
        axis=-1,
    )


def _joint_filter(network: FuzzyNetwork) -> FilterModel:
    robot = LocalizerParameters(
        wheel_radius=WHEEL_RADIUS,
        wheel_separation=WHEEL_SEPARATION,
        encoder_counts_per_revolution=ENCODER_COUNTS_PER_REVOLUTION,
        adaptation="joint",
        compass_gate=0.0,  # all readings are used: there are no outliers, however wrong the start
        lrf_pose_gate=0.0,
        lasting_errors=False,  # every reading teaches: there are no offsets either
    )
    return filter_model(robot, networks_for(robot)._replace(joint=network))
