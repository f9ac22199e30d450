# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The state that outlives a localizer: what is saved, what is refused, what a warm start does."""

import dataclasses
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from localizers import feed, make_localizer, make_parameters, same_estimates, simulated
from places import ROOT

from fnn_ekf_ros.core.lasting.members import HORIZONS_S, MEMBER_COUNT
from fnn_ekf_ros.core.lasting.outages import start_outages, weights_of
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.localizer.saved_state import SavedState
from fnn_ekf_ros.localizer.state_file import (
    SavedStateError,
    StateFile,
    age_in_words,
    read_state,
    render_state,
)
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.localizer import LocalizerParameters

WHEN = datetime(2026, 11, 22, 10, 0, 0, tzinfo=UTC)


@pytest.fixture
def parameters(tmp_path: Path) -> LocalizerParameters:
    return make_parameters(state_file=str(tmp_path / "state.yaml"), warm_start=True)


@pytest.fixture
def state() -> SavedState:
    rng = np.random.default_rng(7)
    root = rng.normal(0.0, 0.1, (3, 3))
    weights = rng.uniform(0.1, 1.0, (len(HORIZONS_S), MEMBER_COUNT))
    return SavedState(
        123_456_789_012,
        np.array([1.0 / 3.0, -2e-5, 3.1]),
        root @ root.T + 1e-4 * np.eye(3),
        rng.uniform(1e-5, 1e-3, 2),
        rng.uniform(1e-4, 1.0, 4),
        np.log(weights / weights.sum(axis=1, keepdims=True)),
    )


def same(one: tuple[Any, ...], other: tuple[Any, ...]) -> None:
    for first, second in zip(one, other, strict=True):
        np.testing.assert_array_equal(first, second)


def test_numbers_survive_to_the_last_bit(
    parameters: LocalizerParameters, state: SavedState
) -> None:
    StateFile(parameters).write(state, WHEN)
    read, saved_at = read_state(Path(parameters.state_file), parameters)
    same(read, state)
    assert saved_at == "2026-11-22 10:00:00+00:00"
    found = StateFile(parameters).find()
    assert found.state is not None
    assert (found.cut_off, found.refused) == (False, "")
    assert found.in_words(Path("x")) == []


def test_a_file_without_weights_of_lasting_errors_is_read(
    parameters: LocalizerParameters, state: SavedState
) -> None:
    """As of an older version, or of another mode."""
    without = state._replace(log_weight=None)
    StateFile(parameters).write(without, WHEN)
    assert "lasting_log_weight" not in Path(parameters.state_file).read_text()
    read = read_state(Path(parameters.state_file), parameters).state
    assert read.log_weight is None
    same(read[:-1], without[:-1])


@pytest.mark.slow
def test_a_file_that_breaks_off_anywhere_is_refused(
    parameters: LocalizerParameters, state: SavedState
) -> None:
    path = Path(parameters.state_file)
    text = render_state(state, parameters, WHEN).rstrip("\n")
    for length in range(0, len(text), 3):
        path.write_text(text[:length])
        with pytest.raises(SavedStateError) as caught:
            read_state(path, parameters)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        (
            "pose",
            "[.nan, 0.0, 0.0]",
            "'pose' is [nan, 0.0, 0.0]: expected a list",
        ),
        ("pose", "[0.0, 0.0, 4.0]", "'pose' is [0.0, 0.0, 4.0]: expected x, y [m] and a yaw"),
        ("pose", "[0.0, 0.0]", "expected a list of 3 finite numbers"),
        ("pose", "here", "'pose' is 'here': expected a list of 3 finite numbers"),
        ("stamp_ns", "1.5", "'stamp_ns' is 1.5: expected a whole number"),
        ("stamp_ns", "true", "'stamp_ns' is True: expected a whole number"),
        ("covariance", "[[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]", "positive definite"),
        ("covariance", "[[1.0, 0.1, 0.0], [0.2, 1.0, 0.0], [0.0, 0.0, 1.0]]", "symmetric"),
        ("covariance", "[[1e300, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]", "'covariance' is"),
        ("covariance", "[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]", "'covariance' is"),
        ("covariance", "[1.0, 2.0, 3.0]", "expected 3 lists of 3 finite"),
        (
            "process_noise",
            "[1e-3, .inf]",
            "'process_noise' is [0.001, inf]: expected a list of 2 finite",
        ),
        ("process_noise", "[-1e-3, 1e-3]", "within the bounds process_noise_std_min"),
        ("measurement_noise", "[1e7, 1.0, 1.0, 1.0]", "bounds measurement_noise_std_min"),
        ("lasting_log_weight", "[[0.0]]", "expected 2 lists of 10 finite numbers"),
        ("lasting_log_weight", f"[{[-2.0] * 10}, {[-2.302585] * 10}]", "weights whose sum is 1"),
        ("lasting_log_weight", f"[{[0.0] + [-200.0] * 9}, {[-2.302585] * 10}]", "weights whose"),
        ("format_version", "2", "'format_version' is 2: expected 1"),
        ("  wheel_radius", "0.03", "'robot': 'wheel_radius' is 0.03: expected 0.025"),
        ("  period", "0.1", "'robot': 'period' is 0.1: expected 0.375"),
        ("  frame_id", "odom", "'robot': 'frame_id' is 'odom': expected map"),
        ("robot", "none", "'robot' holds 'none': expected the parameters of the robot"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(
    parameters: LocalizerParameters, state: SavedState, key: str, value: str, said: str
) -> None:
    lines = render_state(state, parameters, WHEN).splitlines()
    place = next(i for i, line in enumerate(lines) if line.startswith(f"{key}:"))
    end = place + 1
    while end < len(lines) and lines[end].startswith("  ") and not key.startswith(" "):
        end += 1
    lines[place:end] = [f"{key}: {value}"]
    path = Path(parameters.state_file)
    path.write_text("\n".join(lines) + "\n")
    found = StateFile(parameters).find()
    assert found.state is None
    assert said in found.refused
    (line,) = found.in_words(path)
    assert line.startswith(f"state_file '{path}'")
    assert "\n" not in line


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"- 1\n", b"a: [\n", b"&x 1"])
def test_another_file_is_kept_once_when_the_state_is_written(
    parameters: LocalizerParameters, state: SavedState, content: bytes
) -> None:
    path = Path(parameters.state_file)
    broken = path.with_name("state.yaml.broken")
    path.write_bytes(content)
    file = StateFile(parameters)
    assert "kept as 'state.yaml.broken'" in file.find().in_words(path)[0]
    assert path.read_bytes() == content
    file.write(state, WHEN)
    file.write(state, WHEN)
    assert broken.read_bytes() == content
    same(read_state(path, parameters).state, state)

    path.write_bytes(b"again")
    file = StateFile(parameters)
    file.find()
    file.write(state, WHEN)
    assert broken.read_bytes() == content
    assert sorted(entry.name for entry in path.parent.iterdir()) == [path.name, broken.name]


def test_a_place_that_cannot_be_written_to_is_refused_at_once(tmp_path: Path) -> None:
    for name in ("nowhere/state.yaml", "."):
        with pytest.raises(SavedStateError, match="parameter 'state_file' is"):
            StateFile(make_parameters(state_file=str(tmp_path / name))).find()


def test_two_localizers_do_not_share_a_file(parameters: LocalizerParameters) -> None:
    first, second = StateFile(parameters), StateFile(parameters)
    first.claim()
    with pytest.raises(SavedStateError, match="which another localizer uses") as refused:
        second.claim()
    assert "\n" not in str(refused.value)
    first.release()
    second.claim()
    second.release()


CLAIMS = """
import sys
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.localizer.state_file import StateFile
file = StateFile(LocalizerParameters(
    wheel_radius=0.025, wheel_separation=0.6, encoder_counts_per_revolution=500.0,
    state_file=sys.argv[1]))
file.claim()
print("claimed", flush=True)
sys.stdin.read()
"""


def test_a_killed_localizer_leaves_its_file_to_the_next(parameters: LocalizerParameters) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", CLAIMS, parameters.state_file],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    ) as holder:  # fmt: skip
        assert holder.stdout is not None
        assert holder.stdout.readline() == "claimed\n"
        with pytest.raises(SavedStateError, match="which another localizer uses"):
            StateFile(parameters).claim()
        holder.kill()
        holder.stdout.read()
    file = StateFile(parameters)
    file.claim()
    file.release()


def test_the_age_of_a_state_is_told(state: SavedState) -> None:
    assert age_in_words(state, 246_456_789_012) == "its pose is 123 s old"
    assert age_in_words(state, 0) == "its pose is of 123 s, which this clock has not reached"


WRITES_FOREVER = """
import dataclasses, sys
from datetime import UTC, datetime
from pathlib import Path
import numpy as np
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.localizer.saved_state import SavedState
from fnn_ekf_ros.localizer.state_file import StateFile
parameters = LocalizerParameters(
    wheel_radius=0.025, wheel_separation=0.6, encoder_counts_per_revolution=500.0,
    state_file=sys.argv[1])
file = StateFile(parameters)
file.find()
state = SavedState(0, np.zeros(3), np.eye(3), np.full(2, 1e-3), np.full(4, 1e-2))
while True:
    state = state._replace(stamp_ns=state.stamp_ns + 1, pose=state.pose + [1e-3, -1e-3, 0.0])
    file.write(state, datetime.now(UTC))
    print(state.stamp_ns, flush=True)
"""


def test_a_writer_that_is_killed_leaves_a_whole_state(parameters: LocalizerParameters) -> None:
    """Killed in the middle of its work again and again; at least once while it writes."""
    path = Path(parameters.state_file)
    for attempt in range(40):
        with subprocess.Popen(
            [sys.executable, "-c", WRITES_FOREVER, str(path)], stdout=subprocess.PIPE, text=True,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
        ) as writer:  # fmt: skip
            assert writer.stdout is not None
            for _ in range(2 + attempt):
                told = int(writer.stdout.readline())
            while not list(path.parent.glob(f".{path.name}.*")):
                assert writer.poll() is None
            writer.kill()  # it has begun to write
            writer.stdout.read()
        found = StateFile(parameters).find()
        assert found.refused == ""
        assert found.state is not None
        assert found.state.stamp_ns >= told
        np.testing.assert_allclose(found.state.pose[0], 1e-3 * found.state.stamp_ns, rtol=1e-9)
        assert [entry.name for entry in path.parent.iterdir()] == [path.name]
        if found.cut_off:
            (line,) = found.in_words(path)
            assert line == (
                f"the last write of state_file '{path}' was cut off; the state there is from "
                f"{found.saved_at}"
            )
            return
    pytest.fail("no writer was killed while it wrote")


def test_what_is_saved_is_the_noise_without_an_alarm_and_the_last_pose() -> None:
    localizer = make_localizer()
    assert localizer.saved() is None
    outputs = feed(localizer, simulated(30, 30.0).arrivals)
    last = [output.estimate for output in outputs if output.estimate is not None][-1]
    saved = localizer.saved()
    assert saved is not None
    assert saved.stamp_ns == last.stamp_ns
    np.testing.assert_array_equal(saved.pose, last.state.mean)
    np.testing.assert_array_equal(saved.covariance, last.state.covariance)
    assert last.state.lasting is not None
    np.testing.assert_array_equal(saved.log_weight, last.state.lasting.outages.log_weight)
    localizer.advance(saved.stamp_ns - 10 * 10**9)  # the clock goes back: a restart
    assert shown(saved.process_noise) == process_noise_shown(localizer)


def shown(variances: Any) -> str:
    return ", ".join(f"{value:.4g}" for value in np.sqrt(variances))


def process_noise_shown(localizer: Localizer) -> str:
    statuses = {status.name: status for status in localizer.report()}
    return dict(statuses["filter"].values)["process noise std [m, rad]"]


def warm(parameters: LocalizerParameters, state: SavedState) -> Localizer:
    return Localizer(parameters, networks_for(parameters), warm_start=state)


@pytest.mark.parametrize("mode", ["none", "r", "rq", "joint"])
def test_a_warm_start_has_pose_and_noise_at_once(state: SavedState, mode: str) -> None:
    """The given initial pose does not count then; the uncertainty grows by initial_pose_std."""
    std = np.array([0.3, 0.2, 0.1])
    parameters = make_parameters(
        adaptation=mode, initial_pose=[9.0, 9.0, 0.0], initial_pose_std=list(std)
    )
    localizer = warm(parameters, state)
    localizer.advance(20 * 10**9)
    saved = localizer.saved()
    assert saved is not None
    np.testing.assert_array_equal(saved.pose, state.pose)
    np.testing.assert_allclose(saved.covariance, state.covariance + np.diag(std**2), rtol=1e-12)
    np.testing.assert_array_equal(saved.process_noise, state.process_noise)
    np.testing.assert_array_equal(saved.measurement_noise, state.measurement_noise)


def test_a_warm_start_has_the_weights_of_lasting_errors(state: SavedState) -> None:
    """From its first period on; they are kept when the clock jumps, and forgotten by a reset."""
    arrivals = simulated(30, 20.0).arrivals
    localizer = warm(make_parameters(), state)
    first = next(o.estimate for o in feed(localizer, arrivals[:200]) if o.estimate is not None)
    assert first.state.lasting is not None
    np.testing.assert_array_equal(first.state.lasting.outages.log_weight, state.log_weight)
    expected = weights_of(np.asarray(state.log_weight))
    np.testing.assert_array_equal(first.state.lasting.weights, expected)
    localizer.advance(10**9)
    started = [o.estimate for o in feed(localizer, arrivals[:200]) if o.estimate is not None]
    np.testing.assert_array_equal(started[-1].state.lasting.weights, expected)
    localizer.reset()
    cold = [o.estimate for o in feed(localizer, arrivals[:200]) if o.estimate is not None]
    prior = start_outages(()).log_weight
    np.testing.assert_array_equal(cold[-1].state.lasting.outages.log_weight, prior)


@pytest.mark.slow
def test_after_a_reset_the_start_is_cold(state: SavedState) -> None:
    arrivals = simulated(30, 20.0).arrivals
    localizer = warm(make_parameters(), state)
    feed(localizer, arrivals[:200])
    localizer.reset()
    same_estimates(feed(localizer, arrivals), feed(make_localizer(), arrivals))


def test_a_clock_that_jumps_keeps_the_noise_of_a_warm_start_but_not_its_pose(
    state: SavedState,
) -> None:
    localizer = warm(make_parameters(adaptation="none"), state)
    localizer.advance(100 * 10**9)
    assert localizer.saved() is not None
    localizer.advance(10 * 10**9)
    assert localizer.saved() is None
    assert process_noise_shown(localizer) == shown(state.process_noise)


@pytest.mark.slow
def test_the_noise_that_was_learned_serves_a_plain_filter() -> None:
    """R too small by 25: errors of 20 s without adaptation, from a cold start and a warm one."""
    wrong = {"measurement_noise_std": [0.02, 0.02, 0.027]}
    first, second = simulated(31, 60.0), simulated(32, 20.0)
    learned = make_localizer(**wrong)
    feed(learned, first.arrivals)
    kept = learned.saved()
    assert kept is not None
    parameters = make_parameters(**wrong, adaptation="none")
    errors = []
    for start in (None, kept._replace(pose=second.truth[min(second.truth)])):
        localizer = Localizer(parameters, networks_for(parameters), warm_start=start)
        outputs = feed(localizer, second.arrivals)
        poses = [o.estimate for o in outputs if o.estimate and o.stamp_ns in second.truth]
        wrong_by = [np.hypot(*(e.state.mean - second.truth[e.stamp_ns])[:2]) for e in poses]
        errors.append(float(np.sqrt(np.mean(np.square(wrong_by)))))
    cold, warmed = errors
    assert warmed < 0.8 * cold


def test_a_state_of_another_robot_is_no_start(
    parameters: LocalizerParameters, state: SavedState
) -> None:
    StateFile(parameters).write(state, WHEN)
    other = dataclasses.replace(parameters, wheel_separation=0.5)
    found = StateFile(other).find()
    assert found.state is None
    assert "'wheel_separation' is 0.6: expected 0.5" in found.refused
