"""The crisp training set {(u_k, dtheta_k)} of mode joint's network, from simulated robots.

Robots drive the paper's simulations 1 and 2 and are localized by mode joint, which starts with
noise that is right, or wrong by a factor between 1/25 and 25 in variance (evenly in its
logarithm, each of the four log scales theta by its own). At each step at which the settled
learner learns,

    u                               what its evidence asks for
    delta = theta* - theta          the step that would have led to the true noise

are known of every scale, and the network ought to answer E[delta | u]: of all functions of u, that
step leaves the smallest mean square error of theta. One u says little (delta scatters by 0.1 to 1
around a mean of 0.01 to 0.5), so a crisp pair is the mean of all steps with a u of that size, a
few hundred at the least.

How quickly noise should be learned depends on how quickly it changes. Robots whose noise never
does teach a slope of 0.7 near u = 0 and are slow to see that a robot slips; so one in five meets,
in the third fifth of its way, slip or sensors that are `EVENT_SCALE` times noisier. That brings
the slope to 0.9; the natural gradient's own is 1. (After a change the mean of delta does not go
to 0 with u, because evidence comes late. No continuous odd function can follow that.)

The answer near 0 matters most, because u is small most of the time: 95 % of it below 0.1. A pair
weighs 1 / (|u| + FINEST), by which errors count in proportion to the answer.

Two properties are built in rather than learned.

    odd     u and -u make one pair and its mirror image: f(0) = 0, and f is as quick to enlarge
            noise as to reduce it. The settled learner forgets in 200 steps: a constant answer of
            0.001 would be balanced by the evidence only where theta is off by about 0.2.
    bounded a mean beyond `LARGEST_CHANGE` is cut to it.
"""

from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.core.arrays import BoolArray, FloatArray, Row, components_last
from fnn_ekf_ros.core.evidence import SCALE_COUNT
from fnn_ekf_ros.core.filter import step
from fnn_ekf_ros.core.joint_filters import ROW_SCALE
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
from fnn_ekf_ros.study.scenarios import NOMINAL, Scenario, record

PATHS = ("sim1", "sim2")
RUNS = {"constant": 160, "slip": 20, "noisy sensors": 20}
"""Robots on each path, by what happens to them."""
EVENT_SCALE = 25.0
"""Factor on the variance of slip, or of the fixes and the compass, during the event."""
SCENARIOS = {
    "constant": NOMINAL,
    "slip": Scenario(process_scale=EVENT_SCALE),
    "noisy sensors": Scenario(measurement_scale=EVENT_SCALE),
}
STEPS = 400
"""Steps of each robot: 150 s, in which wrong noise has been learned by and large."""
WRONG_BY = 25.0
"""Noise at the start of the robots that are told a wrong one: up to so many times off."""
RIGHT_SHARE = 0.25
"""Part of the robots that are told the right noise."""
LARGEST_CHANGE = 1.0
"""What the network is asked for at the most in one step [log variance]: a factor of 2.7."""
FINEST = 0.05
"""Intervals of |u| widen in proportion to it beyond this [log variance]."""
FARTHEST = 3.0
"""Steps with |u| beyond this are left out; there are hardly any [log variance]."""
INTERVALS = 18
FEWEST_STEPS = 200
"""An interval with fewer steps makes no pair: their mean is too uncertain."""


class JointObservations(NamedTuple):
    """What settled learners asked for and what was right; scales as in `evidence.SCALES`.

    Attributes:
        asked: `(n, 4)` u [log variance].
        wanted_change: `(n, 4)` delta before the step [log variance].
        right: `(n,)` whether the robot was told the right noise at the start.
    """

    asked: FloatArray
    wanted_change: FloatArray
    right: BoolArray


class JointTrainingSet(NamedTuple):
    """Crisp pairs, by u from the smallest to the largest; each mirrored.

    Attributes:
        asked: `(k,)` u [log variance].
        wanted_change: `(k,)` what the network ought to answer [log variance].
        weight: `(k,)` how much a pair counts; their sum is 1.
    """

    asked: FloatArray
    wanted_change: FloatArray
    weight: FloatArray


def make_joint_set(network: FuzzyNetwork, rng: np.random.Generator) -> JointTrainingSet:
    """Return the training set; it takes about half a minute.

    Args:
        network: what mode joint runs on meanwhile.
        rng: source of everything random.
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
        recording: of n robots; what is right or wrong at the start is the noise of step 0.
        network: what mode joint runs on.
        rng: source of the noise at the start and of the first pose's error.
    """
    runs = recording.truth.shape[1]
    right: BoolArray = np.asarray(rng.random(runs) < RIGHT_SHARE)
    wrong_by = WRONG_BY ** rng.uniform(-1.0, 1.0, (runs, SCALE_COUNT))
    assumed = np.where(right[:, None], 1.0, wrong_by)
    Q, R = recording.process_noise[0], recording.measurement_noise[0]
    first = R[:3]
    mean = recording.truth[0] + np.sqrt(first) * rng.standard_normal((runs, len(first)))

    start = Start(mean, np.diag(first), Q * assumed[:, :2], R * assumed[:, ROW_SCALE])

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
        settled = components_last(before.log_scale[:, 0])
        learned: BoolArray = np.asarray(np.any(u != 0.0, axis=-1))
        delta = true_scale[t] - np.log(assumed) - settled
        seen.append((u[learned], delta[learned], right[learned]))
    return JointObservations(*map(np.concatenate, zip(*seen, strict=True)))


def average(seen: JointObservations) -> JointTrainingSet:
    """Return a crisp pair for each interval of |u|, and its mirror image.

    Args:
        seen: steps of all scales; at least `FEWEST_STEPS` in one of the intervals.
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
    """Return the true variance `(T, 4)` that each log scale stands for."""
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
        compass_gate=0.0,  # every reading teaches: none is wild here, however wrong the start
        lrf_pose_gate=0.0,
    )
    return filter_model(robot, networks_for(robot)._replace(joint=network))
