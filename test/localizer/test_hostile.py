# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Hostile messages: nothing they say may end the localizer, or come out of it as nonsense.

`make hostile` runs a million messages with other seeds than the few that run otherwise.
"""

import gc
import itertools
import math
import os
import tracemalloc
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hostile_messages import COMMANDS, EVERYTHING, Command, Recipe, Segment, Sent, Truth, stream
from hostile_work import Totals, Work, counted_steps
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st
from localizers import GEOMETRY, as_object
from rosbags.typesys import Stores, get_typestore

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.localizer.localizer import LONGEST_SILENCE_PERIODS, SMALLEST_STEP_NS, Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.timeline.events import Output

MESSAGES = int(os.environ.get("FNN_EKF_ROS_HOSTILE_MESSAGES", "2500"))
FIRST_SEED = int(os.environ.get("FNN_EKF_ROS_HOSTILE_SEED", "0"))
EXAMPLES = 5
"""Number of recipes that are drawn from each of hypothesis' seeds."""
TYPESTORE = get_typestore(Stores.ROS2_JAZZY)


class Victim:
    """Does with messages what the node does, and looks at all that comes out.

    Attributes:
        errors: distances from the truth of the estimates it is known for [m].
        work: what the messages cost.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self.parameters = parameters
        self.localizer = Localizer(parameters, networks_for(parameters))
        self.work = Work(parameters)
        self.estimates = 0
        self.refused = 0
        self.truth: deque[Truth] = deque(maxlen=200)
        self.errors: list[tuple[float, float]] = []
        self._topics = messages.input_topics(parameters)
        self._period_ns = round(parameters.period * 1e9)
        self._history_ns = round(parameters.history * 1e9)
        self._low, self._high = bounds_of(parameters)
        self._newest_ns = 0
        self._last_ns: int | None = None
        self._leapt = False

    def receive(self, sent: Sent) -> None:
        """As `LocalizerNode._receive`."""
        if sent.now_ns <= 0 or sent.topic not in self._topics:
            return
        self._see_clock(sent.now_ns)
        message = as_object(sent.message)
        outputs, rejected = self.work.check(
            self.localizer,
            sent.now_ns,
            lambda: self.localizer.receive(sent.topic, message, sent.now_ns),
        )
        if rejected is not None:
            assert 0 < len(rejected.reason) < 500
            assert rejected.reason.isprintable(), rejected.reason
            self.refused += 1
        self._check(outputs)

    def command(self, command: Command) -> None:
        """A service call, or parameters that can change at run time."""
        if command.name == "reset":
            self.localizer.reset()
            self._last_ns = None
        elif command.name in ("hold", "learn"):
            self.localizer.enable_adaptation(command.name == "learn")
        else:
            self._change(np.random.default_rng(command.number))

    def _change(self, rng: np.random.Generator) -> None:
        p = self.parameters
        changed = {
            "adaptation": str(rng.choice(["none", "r", "q", "joint"])),
            "process_noise_std_min": np.array(p.process_noise_std) / rng.uniform(1.0, 9.0, 2),
            "process_noise_std_max": np.array(p.process_noise_std) * rng.uniform(1.0, 9.0, 2),
            "measurement_noise_std_max": np.maximum(
                [*p.measurement_noise_std[:2], max(p.measurement_noise_std[2], p.lrf_yaw_std)],
                rng.uniform(0.0, 1.0, 3) * p.measurement_noise_std_max,
            ),
        }
        values = {
            name: value if isinstance(value, str) else np.clip(value, 1e-4, 1e3).tolist()
            for name, value in changed.items()
        }
        now = {name: getattr(p, name) for name in p.__dataclass_fields__}
        self.parameters = build(LocalizerParameters, now | values)
        self.localizer.change(self.parameters, networks_for(self.parameters))
        low, high = bounds_of(self.parameters)
        # What was adapted before stays until it is adapted again.
        self._low, self._high = np.minimum(low, self._low), np.maximum(high, self._high)

    def _see_clock(self, now_ns: int) -> None:
        """Know when the localizer starts anew: then its stamps may jump."""
        if now_ns < self._newest_ns - min(self._history_ns, SMALLEST_STEP_NS):
            self._newest_ns, self._last_ns = now_ns, None
        longest_ns = LONGEST_SILENCE_PERIODS * self._period_ns
        self._leapt |= now_ns > self._newest_ns + longest_ns // 2
        self._newest_ns = max(now_ns, self._newest_ns)

    def _check(self, outputs: list[Output]) -> None:
        for output in outputs:
            assert output.stamp_ns % self._period_ns == 0
            if self._last_ns is not None and not self._leapt:
                assert output.stamp_ns == self._last_ns + self._period_ns
            elif self._last_ns is not None:
                assert output.stamp_ns > self._last_ns
            self._last_ns, self._leapt = output.stamp_ns, False
            if output.statuses is not None:
                said = messages.diagnostics(output.stamp_ns, "localizer", output.statuses)
                assert len(serialized(said)) < 10_000
            if output.estimate is not None:
                self._check_estimate(output)

    def _check_estimate(self, output: Output) -> None:
        estimate = output.estimate
        assert estimate is not None
        self.estimates += 1
        state = estimate.state
        noise = np.concatenate([state.process_noise, state.measurement_noise])
        assert np.all((noise >= self._low) & (noise <= self._high)), noise
        assert -math.pi < state.mean[2] <= math.pi

        odometry = messages.odometry(estimate, "map", "base_link")
        serialized(odometry)
        for part in ("pose", "twist"):
            covariance = odometry.fields[part].fields["covariance"].reshape(6, 6)
            assert np.all(np.isfinite(covariance))
            assert np.array_equal(covariance, covariance.T)
            assert np.linalg.eigvalsh(covariance)[0] > 0.0, covariance
        pose = odometry.fields["pose"].fields["pose"]
        twist = odometry.fields["twist"].fields["twist"]
        assert all(map(math.isfinite, [*numbers_of(pose), *numbers_of(twist)]))
        numbers = messages.noise(estimate)
        assert np.all(np.isfinite(numbers.fields["data"])), numbers.fields["data"]
        serialized(numbers)
        self._compare(output.stamp_ns, state.mean)

    def _compare(self, stamp_ns: int, mean: np.ndarray) -> None:
        """Note the error if the truth is known around this time."""
        for before, after in itertools.pairwise(self.truth):
            if before.stamp_ns < stamp_ns <= after.stamp_ns:
                part = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
                error = mean - (before.pose + part * (after.pose - before.pose))
                self.errors.append((math.hypot(*error[:2]), abs(float(wrap_angle(error[2])))))
                return


def bounds_of(p: LocalizerParameters) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and largest variances of Q and R."""
    low = [*p.process_noise_std_min, *p.measurement_noise_std_min, p.measurement_noise_std_min[2]]
    high = [*p.process_noise_std_max, *p.measurement_noise_std_max, p.measurement_noise_std_max[2]]
    rounding = 1e-12
    return np.square(low) * (1.0 - rounding), np.square(high) * (1.0 + rounding)


def numbers_of(message: Message) -> list[float]:
    """Return all numbers of a tree."""
    found: list[float] = []
    for value in message.fields.values():
        found += numbers_of(value) if isinstance(value, Message) else [float(value)]
    return found


def serialized(message: Message) -> memoryview:
    """Return the message as it would be recorded."""
    return TYPESTORE.serialize_cdr(recordable(message), message.type_name)


def recordable(field: Any) -> Any:
    """Return the rosbags message of a tree."""
    if isinstance(field, Message):
        fields = {name: recordable(value) for name, value in field.fields.items()}
        return TYPESTORE.types[field.type_name](**fields)
    return [recordable(entry) for entry in field] if isinstance(field, list) else field


@st.composite
def parameter_sets(draw: st.DrawFn) -> dict[str, Any]:
    """Parameters from ordinary to extreme, of those that decide what happens to messages."""

    def maybe(values: dict[str, st.SearchStrategy[Any]]) -> dict[str, Any]:
        chosen = draw(st.sets(st.sampled_from(sorted(values)), max_size=len(values)))
        return {name: draw(values[name]) for name in sorted(chosen)}

    # Small std and large: nothing between 1e-4 and 1e3 is forbidden.
    std = st.sampled_from([1e-4, 1e-3, 0.01, 0.1, 1.0, 30.0, 1e3])
    period = draw(st.sampled_from([0.375, 0.375, 0.05, 1.0, 0.1, 10.0, 0.02]))
    gate = st.sampled_from([0.0, 1e-12, 0.01, 0.5])
    delay, angle = st.sampled_from([-2.0, 0.5, 2.0]), st.sampled_from([-2.0 * math.pi, 3.0])
    found = {"period": period, "history": min(2.0, 50.0 * period)} | maybe(
        {
            "adaptation": st.sampled_from(["none", "r", "q", "rq"]),
            "lasting_errors": st.just(False),
            "lrf_use_yaw": st.just(True),
            "lrf_yaw_offset": angle,
            "lrf_pose_scale": st.sampled_from([1e-6, 1e6]),
            "lrf_pose_delay": delay,
            "compass_delay": delay,
            "compass_offset": angle,
            "compass_clockwise": st.just(True),
            "right_inverted": st.just(True),
            "left_wheel_radius_multiplier": st.sampled_from([0.1, 10.0]),
            "right_wheel_radius_multiplier": st.sampled_from([0.1, 10.0]),
            "process_membership_file": st.sampled_from(["initial", "trained"]),
            "lrf_use_message_covariance": st.just(True),
            "motion_model": st.just("paper"),
            "inference": st.just("centroid"),
            "encoder_source": st.just("joint_states"),
            "encoder_bits": st.sampled_from([8, 16, 31]),
            "left_inverted": st.just(True),
            "max_wheel_speed": st.sampled_from([0.01, 1e3]),
            "compass_gate": gate,
            "lrf_pose_gate": gate,
            "history": st.sampled_from([0.0, 0.3, min(10.0, 500.0 * period)]),
            "output_delay": st.sampled_from([0.2, 3.0]),
            "encoder_timeout": st.sampled_from([0.0, 2.0]),
            "innovation_window": st.sampled_from([2, 1000]),
            "initial_pose": st.sampled_from([(0.0, 0.0, 0.0), (1e8, -1e8, 3.0), (0.0, 0.0, 1e8)]),
            "initial_pose_std": st.sampled_from([(1e-4,) * 3, (1e3,) * 3]),
            "membership_file": st.sampled_from(["initial", "trained"]),
            "wheel_radius": st.sampled_from([1e-4, 10.0]),
            "wheel_separation": st.sampled_from([1e-3, 100.0]),
            "gear_ratio": st.sampled_from([1e-6, 1e6]),
            "encoder_counts_per_revolution": st.sampled_from([1e-3, 1e9]),
        }
    )
    for name, size in (("process_noise_std", 2), ("measurement_noise_std", 3)):
        if draw(st.booleans()):
            triples = [sorted(draw(st.tuples(std, std, std))) for _ in range(size)]
            for suffix, values in zip(
                ("_min", "", "_max"), zip(*triples, strict=True), strict=True
            ):
                found[name + suffix] = values
    if "measurement_noise_std" in found:
        found["lrf_yaw_std"] = found["measurement_noise_std"][2]
    return found


segments = st.builds(
    Segment,
    st.lists(st.sampled_from(EVERYTHING), max_size=6, unique=True).map(tuple),
    st.sampled_from([0.5, 0.1, 0.02, 1.0]),
    st.sampled_from([20, 60, 150]),
)
drives = st.lists(segments, min_size=1, max_size=6).map(tuple)
recipes = st.builds(Recipe, st.integers(0, 2**32 - 1), drives)


def play(recipe: Recipe, localizer: Victim) -> int:
    """Send a whole stream; returns how many messages it had."""
    sent_count = 0
    for each in stream(recipe, localizer.parameters):
        if isinstance(each, Truth):
            localizer.truth.append(each)
        elif isinstance(each, Command):
            localizer.command(each)
        else:
            localizer.receive(each)
            sent_count += 1
    return sent_count


def run_examples(
    test: Callable[..., None], strategies: Sequence[Any], number: int, examples: int
) -> None:
    """Run a test on values drawn from one of hypothesis' seeds."""
    configure = settings(
        max_examples=examples,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    configure(seed(FIRST_SEED + number)(given(*strategies)(test)))()


@pytest.mark.slow
def test_whatever_comes_the_output_is_sound_and_the_work_bounded() -> None:
    """Finite, positive definite, in order, within bounds; and nothing is ever raised.

    Of each message, and of all messages of a configuration, the filter steps are bounded, and so
    is what is kept (`hostile_work`).
    """
    estimates = refused = 0
    totals = Totals()
    configurations = set()

    def never_nonsense(changes: dict[str, Any], recipe: Recipe) -> None:
        nonlocal estimates, refused, totals
        localizer = Victim(build(LocalizerParameters, GEOMETRY | changes))
        play(recipe, localizer)
        totals = totals.with_more(localizer.work.totals)
        configurations.add(repr(changes))
        estimates += localizer.estimates
        refused += localizer.refused

    with counted_steps():
        for number in itertools.count():
            run_examples(never_nonsense, (parameter_sets(), recipes), number, EXAMPLES)
            if totals.messages >= MESSAGES:
                break
    print(
        f"{totals.messages} messages, {len(configurations)} configurations, {refused} refused, "
        f"{estimates} odom, {totals.periods} periods, {totals.steps} steps, at most "
        f"{totals.worst_steps} for a message; kept at most {totals.most_checkpoints} periods, "
        f"{totals.most_readings} readings of a sensor; seeds {FIRST_SEED} to {FIRST_SEED + number}"
    )
    assert estimates > totals.messages / 100  # the filter was running
    assert refused > totals.messages / 200  # and not because the messages were good
    assert len(configurations) >= MESSAGES // 2000
    assert totals.steps > totals.periods / 2  # the steps were counted


@pytest.mark.slow
def test_afterwards_the_robot_is_found_again() -> None:
    """A minute of ordinary messages after the attacks is enough, whatever was learned of them."""
    worst: list[tuple[float, float]] = []

    def finds_it(adaptation: str, drive: tuple[Segment, ...], number: int) -> None:
        parameters = build(LocalizerParameters, GEOMETRY | {"adaptation": adaptation})
        localizer = Victim(parameters)
        kept = [name for name in EVERYTHING if name not in ("change", "hold")]
        asked = tuple(
            s._replace(attacks=tuple(name for name in s.attacks if name in kept)) for s in drive
        )
        play(Recipe(number, (*asked, Segment((), 0.0, 1200))), localizer)
        late = localizer.errors[-40:]  # 15 s of it
        assert len(late) == 40
        worst.append((max(e[0] for e in late), max(e[1] for e in late)))
        assert worst[-1][0] < 0.5
        assert worst[-1][1] < 0.5

    drawn = st.sampled_from(["joint", "none", "r"]), drives, st.integers(0, 2**32 - 1)
    run_examples(finds_it, drawn, 0, max(3, MESSAGES // 10_000))
    print(f"worst of {len(worst)}: {max(e[0] for e in worst):.3f} m")


@pytest.mark.slow
def test_memory_is_flat() -> None:
    """The second half of a long stream of everything leaves nothing behind."""
    every = tuple(name for name in EVERYTHING if name not in COMMANDS)
    cycle = [Segment((name,), 0.2, 20) for name in every] + [Segment((), 0.0, 50)]
    localizer = Victim(build(LocalizerParameters, GEOMETRY | {"adaptation": "r"}))
    kept: list[int] = []
    tracemalloc.start()
    try:
        # What is remembered of some minutes is full after the first half.
        for number in range(max(8, MESSAGES // 25_000)):
            play(Recipe(number, tuple(cycle)), localizer)
            localizer.errors.clear()
            gc.collect()
            kept.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    print(f"kB kept: {[round(size / 1e3) for size in kept]}")
    half = len(kept) // 2
    # What a cycle happens to leave in buffers differs by more than this; a leak moves them all.
    assert np.median(kept[half:]) < max(kept[:half]) + 50_000
