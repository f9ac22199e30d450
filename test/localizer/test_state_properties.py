# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""State files: what any localizer writes it can read, and nobody else's file is touched."""

import dataclasses
import math
import os
import stat
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from localizers import GEOMETRY, START_NS, feed, make_parameters, simulated

from fnn_ekf_ros.files.yaml_text import load_yaml
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.localizer.saved_state import SavedState
from fnn_ekf_ros.localizer.state_file import (
    ROBOT,
    SavedStateError,
    StateFile,
    read_state,
    render_state,
)
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.files import render_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import ParameterError, ParameterValue, Spec, build, fields_of
from fnn_ekf_ros.timeline.events import PoseReset

WHEN = datetime(2026, 11, 22, 10, 0, 0, tzinfo=UTC)
STATE = SavedState(
    stamp_ns=123,
    pose=np.array([1.0, 2.0, 3.0]),
    covariance=0.01 * np.eye(3),
    process_noise=np.full(2, 1e-3),
    measurement_noise=np.full(4, 1e-2),
)
STILL_HOLDS = {
    # Where the filter starts, what it may learn and how.
    "process_noise_std", "measurement_noise_std", "lrf_yaw_std", "process_noise_std_min",
    "process_noise_std_max", "measurement_noise_std_min", "measurement_noise_std_max",
    "adaptation", "lasting_errors", "innovation_window", "membership_file",
    "process_membership_file", "joint_membership_file", "inference", "motion_model",
    "initial_pose", "initial_pose_std", "lrf_use_yaw",
    # What it takes for an outlier or a glitch, and how long it waits.
    "compass_gate", "lrf_pose_gate", "max_wheel_speed", "encoder_timeout", "history",
    "output_delay",
    # What it publishes and keeps.
    "base_frame", "publish_tf", "odom_frame", "transform_tolerance", "state_file", "warm_start",
}  # fmt: skip
"""Parameters that may change from the run that saved a state to the one that starts from it."""
FILES = {
    "membership_file": ["initial", "published", "trained"],
    "process_membership_file": ["same", "initial", "published", "trained"],
    "joint_membership_file": ["joint"],
}
"""Words of the parameters that name files."""


def a_value(name: str, spec: Spec, default: ParameterValue) -> st.SearchStrategy[Any]:
    """Return the values that a parameter may have, by itself."""
    if name in FILES:
        return st.sampled_from(FILES[name])
    if isinstance(default, bool):
        return st.booleans()
    if isinstance(default, str):
        if spec.choices:
            return st.sampled_from(spec.choices)
        return st.text(min_size=1, max_size=8).filter(str.isprintable)
    number = st.floats(max(spec.at_least, -1e300), min(spec.at_most, 1e300))
    if isinstance(default, tuple):
        numbers = st.tuples(*[number] * len(default))
        return numbers | st.just(default) if spec.may_be_nan else numbers
    return number.map(int) if isinstance(default, int) else number


@st.composite
def any_parameters(draw: st.DrawFn) -> LocalizerParameters:
    """Draw parameters that the localizer takes: some changed at once, where they fit together."""
    drawn: dict[str, Any] = dict(GEOMETRY)
    fields = fields_of(LocalizerParameters)
    for name, spec, default in draw(st.lists(st.sampled_from(fields), max_size=30)):
        if name in ("state_file", "warm_start"):
            continue
        changed = drawn | {name: draw(a_value(name, spec, default))}
        for start in ("process_noise_std", "measurement_noise_std"):
            if name.removesuffix("_min").removesuffix("_max") == start:
                drawn_std = sorted(
                    zip(*draw(st.tuples(*[a_value(name, spec, default)] * 3)), strict=True)
                )
                low, middle, high = zip(*(sorted(each) for each in drawn_std), strict=True)
                changed |= {f"{start}_min": low, start: middle, f"{start}_max": high}
                if start == "measurement_noise_std":
                    changed["lrf_yaw_std"] = middle[2]
        try:
            build(LocalizerParameters, changed)
        except ParameterError:  # it does not fit the others
            continue
        drawn = changed
    return build(LocalizerParameters, drawn)


def read_again(localizer: Localizer) -> SavedState:
    """Write what a localizer saves and return what it reads of it."""
    saved = localizer.saved()
    assert saved is not None
    with tempfile.TemporaryDirectory() as folder:
        parameters = dataclasses.replace(
            localizer.parameters, state_file=str(Path(folder) / "state.yaml")
        )
        StateFile(parameters).write(saved, WHEN)
        found = StateFile(parameters).find()
    assert found.refused == ""
    assert found.state is not None
    for one, other in zip(found.state, saved, strict=True):
        np.testing.assert_array_equal(one, other)
    return found.state


def localizer_of(parameters: LocalizerParameters, start: SavedState | None = None) -> Localizer:
    return Localizer(parameters, networks_for(parameters), warm_start=start)


@settings(max_examples=40)
@given(any_parameters())
def test_a_state_that_is_saved_while_waiting_can_be_read(parameters: LocalizerParameters) -> None:
    """From the given pose, and again from the file: the pose is the given one but for turns."""
    if math.isnan(parameters.initial_pose[0]):
        parameters = dataclasses.replace(parameters, initial_pose=(1.0, 2.0, 0.5))
    localizer = localizer_of(parameters)
    localizer.advance(START_NS)
    read = read_again(localizer)
    np.testing.assert_array_equal(read.pose[:2], parameters.initial_pose[:2])
    turned = parameters.initial_pose[2] - read.pose[2]
    assert math.cos(turned) > 1.0 - 1e-9
    again = localizer_of(parameters, start=read)
    again.advance(START_NS)
    read_again(again)


@pytest.mark.slow
@settings(max_examples=4)
@given(any_parameters(), st.floats(1e-4, 1e3))
def test_a_state_that_is_saved_on_the_way_can_be_read(
    parameters: LocalizerParameters, std: float
) -> None:
    """After some readings, and right after a pose that is set with any uncertainty."""
    localizer = localizer_of(parameters)
    arrivals = simulated(30, 3.0).arrivals
    feed(localizer, arrivals)
    if localizer.saved() is not None:
        read_again(localizer)
    now_ns = arrivals[-1].now_ns
    set_pose = PoseReset(now_ns, np.array([1e8, -1e8, 3.0]), std**2 * np.eye(3))
    localizer.add(set_pose, now_ns)
    localizer.advance(now_ns + 30 * 10**9)
    if localizer.saved() is not None:
        read_again(localizer)


@pytest.mark.parametrize("mode", ["none", "joint"])
def test_the_noise_of_a_vague_start_beyond_pi_is_not_lost(tmp_path: Path, mode: str) -> None:
    parameters = make_parameters(
        initial_pose=[1.0, 2.0, 4.0], initial_pose_std=[1e3, 1e3, 1e3], adaptation=mode,
        state_file=str(tmp_path / "state.yaml"),
    )  # fmt: skip
    localizer = localizer_of(parameters, STATE._replace(process_noise=np.array([2e-3, 3e-3])))
    localizer.advance(START_NS)
    np.testing.assert_array_equal(read_again(localizer).process_noise, [2e-3, 3e-3])


def test_noise_beyond_the_bounds_of_the_next_start_is_at_the_bound(tmp_path: Path) -> None:
    """The bounds were changed at run time, and are again what they were."""
    parameters = make_parameters(
        state_file=str(tmp_path / "s.yaml"), process_noise_std_max=[1.0, 1.0]
    )
    localizer = localizer_of(dataclasses.replace(parameters, process_noise_std_max=(10.0, 3.0)),
                             STATE._replace(process_noise=np.array([4.0, 0.5])))  # fmt: skip
    localizer.advance(START_NS)
    saved = localizer.saved()
    assert saved is not None
    np.testing.assert_array_equal(saved.process_noise, [4.0, 0.5])
    StateFile(parameters).write(saved, WHEN)
    found = StateFile(parameters).find().state
    assert found is not None
    np.testing.assert_array_equal(found.process_noise, [1.0, 0.5])


def test_it_is_decided_for_each_parameter_whether_a_state_outlives_its_change() -> None:
    names = {name for name, _, _ in fields_of(LocalizerParameters)}
    assert not STILL_HOLDS & set(ROBOT)
    assert STILL_HOLDS | set(ROBOT) == names


OTHER = {
    "encoder_source": "joint_states", "encoder_bits": 16, "left_joint": "a", "right_joint": "b",
    "frame_id": "arena",
}  # fmt: skip


@pytest.mark.parametrize("name", ROBOT)
def test_a_state_of_other_readings_is_refused(tmp_path: Path, name: str) -> None:
    parameters = make_parameters(state_file=str(tmp_path / "state.yaml"))
    StateFile(parameters).write(STATE, WHEN)
    before = getattr(parameters, name)
    if name in OTHER:
        after = OTHER[name]
    else:
        after = not before if isinstance(before, bool) else before + 0.25
    refused = StateFile(dataclasses.replace(parameters, **{name: after})).find().refused
    shown = repr(before)
    assert f"'{name}' is {shown}: expected {after}, as in the parameters" in refused


def test_a_file_of_an_older_version_is_compared_with_what_it_has(tmp_path: Path) -> None:
    parameters = make_parameters(compass_offset=0.3)
    path = tmp_path / "state.yaml"
    first = (*ROBOT[:7], "format_version", "saved_at")
    lines = [
        line
        for line in render_state(STATE, parameters, WHEN).splitlines()
        if not line.startswith("  ")
        or line.startswith("  -")
        or line.split(":")[0].strip() in first
    ]
    path.write_text("\n".join(lines) + "\n")
    np.testing.assert_array_equal(read_state(path, parameters).state.pose, STATE.pose)
    path.write_text("\n".join(line for line in lines if "  period" not in line) + "\n")
    with pytest.raises(SavedStateError, match=r"'period' is missing: expected 0\.375"):
        read_state(path, parameters)


def test_names_in_any_script_come_back() -> None:
    name = "r\N{ROBOT FACE}\N{HANGUL SYLLABLE GA}"
    parameters = make_parameters(frame_id=name)
    text = render_state(STATE, parameters, WHEN)
    assert load_yaml(text, "x", SavedStateError)["robot"]["frame_id"] == name
    text = render_parameter_file(LocalizerParameters, {"frame_id": name}, NODE_NAME)
    read = load_yaml(text, "x", SavedStateError)
    assert read[f"/**/{NODE_NAME}"]["ros__parameters"]["frame_id"] == name


@pytest.mark.parametrize("there", [True, False])
def test_no_link_is_followed(tmp_path: Path, there: bool) -> None:
    """The old names of partial files, as many as a process can have, and the lock."""
    folder, victim = tmp_path / "shared", tmp_path / "victim"
    folder.mkdir()
    if there:
        victim.write_text("mine")
    parameters = make_parameters(state_file=str(folder / "state.yaml"))
    (folder / f".state.yaml.{os.getpid()}").symlink_to(victim)
    StateFile(parameters).write(STATE, WHEN)
    assert read_state(folder / "state.yaml", parameters).state.stamp_ns == STATE.stamp_ns
    (folder / "state.yaml.lock").symlink_to(victim)
    with pytest.raises(SavedStateError, match=r"state.yaml.lock' cannot be locked: it is a symb"):
        StateFile(parameters).claim()
    assert victim.exists() == there
    assert not there or victim.read_text() == "mine"


def test_the_name_of_a_partial_file_cannot_be_guessed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Path] = []
    replace = Path.replace

    def noted(self: Path, target: Path) -> Path:
        seen.append(self)
        assert stat.S_ISREG(self.lstat().st_mode)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", noted)
    parameters = make_parameters(state_file=str(tmp_path / "state.yaml"))
    for _ in range(2):
        StateFile(parameters).write(STATE, WHEN)
    assert len(set(seen)) == 2
    assert not any(str(os.getpid()) == path.name.rpartition(".")[2] for path in seen)


def test_a_link_under_the_very_name_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    monkeypatch.setattr("secrets.token_hex", lambda count: "0" * (2 * count))
    (tmp_path / f".state.yaml.{'0' * 12}").symlink_to(victim)
    parameters = make_parameters(state_file=str(tmp_path / "state.yaml"))
    with pytest.raises(Exception, match="cannot be written: File exists"):
        StateFile(parameters).write(STATE, WHEN)
    assert victim.read_text() == "mine"
