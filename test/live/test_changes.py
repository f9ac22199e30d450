# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters that are set while the localizer runs."""

from collections.abc import Callable
from typing import Any

import pytest
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python
from std_srvs.srv import SetBool

pytestmark = pytest.mark.live

MakeBench = Callable[..., Any]


def request(kind: Any, **values: Any) -> Any:
    messages = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    return kind.Request(parameters=messages)


def set_one(bench: Any, **values: Any) -> tuple[bool, str]:
    name = "localizer/set_parameters"
    (result,) = bench.call(SetParameters, name, request(SetParameters, **values)).results
    return result.successful, result.reason


def set_together(bench: Any, **values: Any) -> tuple[bool, str]:
    name = "localizer/set_parameters_atomically"
    asked = request(SetParametersAtomically, **values)
    result = bench.call(SetParametersAtomically, name, asked).result
    return result.successful, result.reason


def values_now(bench: Any, *names: str) -> list[Any]:
    asked = GetParameters.Request(names=list(names))
    answer = bench.call(GetParameters, "localizer/get_parameters", asked)
    return [parameter_value_to_python(value) for value in answer.values]


def test_adaptation_is_changed_and_shown(
    bench: MakeBench, capfd: pytest.CaptureFixture[str]
) -> None:
    opened = bench()
    assert set_one(opened, adaptation="r") == (True, "")
    assert opened.localizer.localizer.parameters.adaptation == "r"
    assert values_now(opened, "adaptation") == ["r"]
    assert "adaptation is r now, was joint" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"adaptation": "all"}, "parameter 'adaptation' is 'all': expected one of none, r, q"),
        (
            {"process_noise_std_max": [0.01, 0.01]},
            "0.05235987755982989]: expected numbers "
            "between process_noise_std_min [0.0001, 0.0001] and process_noise_std_max [0.01, 0.01]",
        ),
        (
            {"measurement_noise_std_min": [-1.0, 0.1, 0.1]},
            "parameter 'measurement_noise_std_min' is [-1.0, 0.1, 0.1]: expected a list of 3",
        ),
        (
            {"measurement_noise_std_min": [0.1]},
            "parameter 'measurement_noise_std_min' is [0.1]: expected a list of 3",
        ),
        ({"adaptation": True}, "BOOL"),
        ({"period": 1.0}, "read-only"),
        ({"adaptations": "r"}, "undeclared parameter"),
    ],
)
def test_a_refused_change_gives_its_reason_and_changes_nothing(
    bench: MakeBench, values: dict[str, Any], reason: str
) -> None:
    opened = bench()
    before = opened.localizer.localizer.parameters
    for ask in (set_one, set_together):
        successful, said = ask(opened, **values)
        assert not successful
        assert reason in said
        assert "\n" not in said
    assert opened.localizer.localizer.parameters is before


def test_several_that_only_make_sense_together_are_set_together(bench: MakeBench) -> None:
    """Integers count as floats here, too; what cannot be set takes the others with it."""
    opened = bench("-p", "process_noise_std:=[0.05, 0.05]")
    wide = {"process_noise_std_max": [2, 1], "process_noise_std_min": [0.01, 0.02]}
    assert set_together(opened, adaptation="q", **wide) == (True, "")
    now = opened.localizer.localizer.parameters
    assert now.adaptation == "q"
    assert now.process_noise_std_max == (2.0, 1.0)
    assert now.process_noise_std_min == (0.01, 0.02)
    shown = values_now(opened, "process_noise_std_max")[0]
    assert list(shown) == [2.0, 1.0]

    successful, _ = set_together(opened, adaptation="r", process_noise_std_min=[0.1, 0.1])
    assert not successful
    assert values_now(opened, "adaptation") == ["q"]
    assert opened.localizer.localizer.parameters is now


def test_adaptation_none_is_mended_by_the_parameter(bench: MakeBench) -> None:
    opened = bench("-p", "adaptation:=none")
    name = "localizer/enable_adaptation"
    refused = opened.call(SetBool, name, SetBool.Request(data=True))
    assert not refused.success
    assert refused.message == (
        "adaptation is 'none': `ros2 param set /localizer adaptation joint` (or rq, r, q) first"
    )
    assert set_one(opened, adaptation="joint") == (True, "")
    enabled = opened.call(SetBool, name, SetBool.Request(data=True))
    assert (enabled.success, enabled.message) == (True, "adaptation joint is on")


def test_use_sim_time_can_still_be_set(bench: MakeBench) -> None:
    assert set_one(bench(), use_sim_time=False) == (True, "")
