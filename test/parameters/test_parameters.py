# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameter sets: defaults, what is refused, and in which words."""

import dataclasses
import math
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from localizers import GEOMETRY

from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import ParameterError, Parameters, build, fields_of

SETS: list[tuple[type[Parameters], dict[str, Any]]] = [
    (LocalizerParameters, GEOMETRY),
    (FakeRobotParameters, {}),
]
FIELDS = [
    pytest.param(kind, needed, *field, id=f"{kind.__name__}-{field[0]}")
    for kind, needed in SETS
    for field in fields_of(kind)
]
KINDS = {"number": float, "whole": int, "word": str, "truth": bool, "list": tuple}


def refused(kind: type[Parameters], values: dict[str, Any]) -> str:
    """Return the one line with which values are refused."""
    with pytest.raises(ParameterError) as caught:
        build(kind, values)
    line = str(caught.value)
    assert "\n" not in line
    return line


def is_kind(default: object, *names: str) -> bool:
    return type(default) in [KINDS[name] for name in names]


def bad_values(spec: Any, default: Any) -> list[Any]:
    """Return values that do not fit a parameter, whatever its meaning."""
    if is_kind(default, "truth"):
        return [0, 1, 0.0, "true", None, [True], math.nan]
    if is_kind(default, "word"):
        words: list[Any] = ["", 1, 1.5, True, False, None, ["none"], {"a": 1}]
        return words + (["off ", "NONE", default.upper()] if spec.choices else [])
    if is_kind(default, "list"):
        good, many = list(default), len(default)
        filled = [1.0] * many
        lists = [filled[:-1], [*filled, 1.0], [], "1.0", 1.0, True, None, {"a": 1.0}]
        entries: list[Any] = ["1", True, None, [1.0], math.inf, -math.inf, *outside(spec)]
        entries += [] if spec.may_be_nan else [math.nan]
        base = filled if math.isnan(good[0]) else good
        return lists + [[*base[:-1], entry] for entry in entries]
    wrong: list[Any] = [True, False, "1", "", None, [1.0], {"a": 1}, math.nan, math.inf, -math.inf]
    return wrong + outside(spec) + ([1.5 + default] if is_kind(default, "whole") else [])


def outside(spec: Any) -> list[float]:
    """Return the numbers just outside of a range."""
    numbers = []
    if spec.at_least > -math.inf:
        numbers += [spec.at_least - max(1e-9, 1e-9 * abs(spec.at_least)), spec.at_least - 1.0]
    if spec.at_most < math.inf:
        numbers += [math.nextafter(spec.at_most, math.inf), 2.0 * spec.at_most + 1.0]
    return numbers


def inside(spec: Any) -> list[float]:
    """Return the ends of a range."""
    low = [spec.at_least] if spec.at_least > -math.inf else []
    return low + ([spec.at_most] if spec.at_most < math.inf else [])


def test_localizer_needs_its_geometry_and_nothing_else() -> None:
    made = build(LocalizerParameters, GEOMETRY)
    for name, _, default in fields_of(LocalizerParameters):
        if name in GEOMETRY:
            assert getattr(made, name) == GEOMETRY[name]
        elif name != "initial_pose":
            assert getattr(made, name) == default
            assert type(getattr(made, name)) is type(default)
    assert all(map(math.isnan, made.initial_pose))


def test_fake_robot_needs_nothing() -> None:
    made = FakeRobotParameters()
    assert dataclasses.asdict(made) == {n: d for n, _, d in fields_of(FakeRobotParameters)}


def test_defaults_are_the_papers() -> None:
    made = build(LocalizerParameters, GEOMETRY)
    assert made.process_noise_std == (0.05, math.radians(3.0))
    assert made.measurement_noise_std == pytest.approx(np.sqrt([0.01, 0.01, 0.018]), rel=1e-15)
    assert made.period == 0.375
    assert made.gear_ratio == 1.0
    assert made.innovation_window == 45
    robot = FakeRobotParameters()
    assert (robot.wheel_radius, robot.wheel_separation) == (0.025, 0.6)
    assert (robot.gear_ratio, robot.encoder_counts_per_revolution) == (1.0, 500.0)
    assert robot.slip() == (0.05, math.radians(3.0))
    assert robot.wheel_speed_error == 0.05


@pytest.mark.parametrize(("kind", "needed", "name", "spec", "default"), FIELDS)
def test_every_parameter_says_what_it_is(
    kind: type[Parameters], needed: dict[str, Any], name: str, spec: Any, default: Any
) -> None:
    assert re.fullmatch(r"[A-Za-z][^\n]*[.)]", spec.doc)
    assert re.fullmatch(r"[a-z][a-z0-9_]*", name)
    if is_kind(default, "number", "list"):
        assert spec.unit or spec.doc
        assert spec.may_be_nan or inside(spec), "a number without a range"
    if name.endswith("_std"):
        assert spec.unit


@pytest.mark.parametrize(("kind", "needed", "name", "spec", "default"), FIELDS)
def test_a_bad_value_gives_one_line_with_name_value_and_expectation(
    kind: type[Parameters], needed: dict[str, Any], name: str, spec: Any, default: Any
) -> None:
    for value in bad_values(spec, default):
        line = refused(kind, needed | {name: value})
        assert line.startswith(f"parameter '{name}' is "), value
        assert ": expected " in line
        if not (spec.required or name in GEOMETRY) or value != 0.0:
            shown = line.removeprefix(f"parameter '{name}' is ").split(": expected ")[0]
            assert shown == repr(value) or isinstance(value, float | list | tuple), line
            if isinstance(value, int | float) and not isinstance(value, bool):
                assert shown == repr(value) or float(shown) == value or math.isnan(value)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("kind", "needed", "name", "spec", "default"),
    [p for p in FIELDS if type(p.values[4]) is int],
)
def test_a_whole_number_must_be_finite(
    kind: type[Parameters], needed: dict[str, Any], name: str, spec: Any, default: Any, value: float
) -> None:
    assert refused(kind, needed | {name: value}).startswith(f"parameter '{name}' is {value}: ")


@pytest.mark.parametrize(("kind", "needed", "name", "spec", "default"), FIELDS)
def test_the_ends_of_a_range_belong_to_it(
    kind: type[Parameters], needed: dict[str, Any], name: str, spec: Any, default: Any
) -> None:
    for number in inside(spec):
        values = needed | {name: number}
        if is_kind(default, "list"):
            values[name] = [number] * len(default)
        try:
            build(kind, values)
        except ParameterError as error:  # a rule that concerns several parameters
            line = str(error)
        else:
            line = "_min"
        assert "_min" in line or name == "encoder_counts_per_revolution"


@pytest.mark.parametrize(("kind", "needed", "name", "spec", "default"), FIELDS)
def test_integers_count_as_floats_and_whole_floats_as_integers(
    kind: type[Parameters], needed: dict[str, Any], name: str, spec: Any, default: Any
) -> None:
    if is_kind(default, "number"):
        whole = int(max(spec.at_least, 0)) + 1
        if whole <= spec.at_most:
            made = getattr(build(kind, needed | {name: whole}), name)
            assert (made, type(made)) == (whole, float)
    elif is_kind(default, "whole"):
        made = getattr(build(kind, needed | {name: float(default)}), name)
        assert (made, type(made)) == (default, int)
    elif name == "initial_pose":
        made = getattr(build(kind, needed | {name: [1, 2.5, 3]}), name)
        assert (made, [type(entry) for entry in made]) == ((1.0, 2.5, 3.0), [float] * 3)


def test_an_unknown_name_is_refused_with_the_nearest_known_one() -> None:
    line = refused(LocalizerParameters, GEOMETRY | {"wheel_seperation": 0.5})
    assert line == "unknown parameter 'wheel_seperation': did you mean 'wheel_separation'?"
    line = refused(LocalizerParameters, GEOMETRY | {"zzz": 1})
    assert line.startswith("unknown parameter 'zzz': expected one of wheel_radius, ")
    assert refused(FakeRobotParameters, {"sead": 1}).endswith("did you mean 'seed'?")


@pytest.mark.parametrize(
    "name",
    ["use_sim_time", "qos_overrides./odom.publisher.depth", "start_type_description_service"],
)
def test_what_every_node_accepts_is_passed_over(name: str) -> None:
    assert build(LocalizerParameters, GEOMETRY | {name: True}).wheel_radius == 0.025


@pytest.mark.parametrize("name", ["use_sim_times", "qos_overrides"])
def test_what_only_looks_like_it_is_not(name: str) -> None:
    assert f"unknown parameter '{name}'" in refused(LocalizerParameters, GEOMETRY | {name: True})


@pytest.mark.parametrize("name", GEOMETRY)
def test_unset_geometry_is_called_unset(name: str) -> None:
    without = {key: value for key, value in GEOMETRY.items() if key != name}
    for values in (without, without | {name: 0}, without | {name: 0.0}):
        line = refused(LocalizerParameters, values)
        assert line.startswith(f"parameter '{name}' is not set: expected a number ")


def test_joint_states_need_no_counts_per_revolution() -> None:
    values = {"wheel_radius": 0.1, "wheel_separation": 0.5, "encoder_source": "joint_states"}
    assert build(LocalizerParameters, values).encoder_counts_per_revolution == 0.0


@pytest.mark.parametrize("name", ["adaptation", "encoder_source", "motion_model", "inference"])
def test_a_bare_off_is_explained(name: str) -> None:
    line = refused(LocalizerParameters, GEOMETRY | {name: False})
    assert line.startswith(f"parameter '{name}' is False: expected one of ")
    assert line.endswith("(a bare off, no, on or yes is a truth value in YAML)")


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"process_noise_std_min": [0.1, 0.01]}, "process_noise_std"),
        ({"process_noise_std": [0.1, 4.0]}, "process_noise_std"),
        ({"measurement_noise_std": [0.1, 0.1, 1e-4]}, "measurement_noise_std"),
        ({"measurement_noise_std_max": [0.05, 0.2, 0.2]}, "measurement_noise_std"),
        ({"process_noise_std_min": [0.06, 0.01]}, "process_noise_std"),
        ({"lrf_yaw_std": 5.0}, "lrf_yaw_std"),
        ({"lrf_yaw_std": 5e-4}, "lrf_yaw_std"),
    ],
)
def test_noise_must_start_within_its_bounds(values: dict[str, Any], name: str) -> None:
    line = refused(LocalizerParameters, GEOMETRY | values)
    assert line.startswith(f"parameter '{name}' is ")
    assert "_min" in line
    assert "_max" in line


@pytest.mark.parametrize("pose", [[math.nan, 0.0, 0.0], [0.0, 0.0, math.nan], [math.inf, 0.0, 0.0]])
def test_an_initial_pose_is_whole_or_not_there(pose: list[float]) -> None:
    assert "'initial_pose'" in refused(LocalizerParameters, GEOMETRY | {"initial_pose": pose})


def test_parameters_cannot_be_changed() -> None:
    made = build(LocalizerParameters, GEOMETRY)
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.wheel_radius = 1.0  # type: ignore[misc]


def test_path_sim1_brings_its_own_slip_unless_slip_is_given() -> None:
    assert build(FakeRobotParameters, {"path": "sim1"}).slip() == (0.02, math.radians(1.0))
    assert build(FakeRobotParameters, {"path": "sim2"}).slip() == (0.05, math.radians(3.0))
    assert build(FakeRobotParameters, {"path": "sim1", "slip_std": [0.3, 0.2]}).slip() == (0.3, 0.2)


@settings(derandomize=True, deadline=None, max_examples=80)
@given(
    name=st.sampled_from([name for name, _, _ in fields_of(LocalizerParameters)]),
    value=st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
        lambda inner: (
            st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
        ),
        max_leaves=5,
    ),
)
def test_whatever_comes_is_taken_or_refused_in_one_line(name: str, value: Any) -> None:
    default = {n: d for n, _, d in fields_of(LocalizerParameters)}[name]
    try:
        made = build(LocalizerParameters, GEOMETRY | {name: value})
    except ParameterError as error:
        line = str(error)
    else:
        line = f"'{name}'"
        assert type(getattr(made, name)) is type(default)
    assert "\n" not in line
    assert f"'{name}'" in line
