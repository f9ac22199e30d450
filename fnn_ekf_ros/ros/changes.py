# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameters that change while a node runs: checked as at its start, whole or not at all."""

import dataclasses
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.schema import ParametersT, fields_of
from fnn_ekf_ros.ros.runtime import plain

from rcl_interfaces.msg import SetParametersResult  # isort: skip
from rclpy.node import Node  # isort: skip
from rclpy.parameter import Parameter  # isort: skip

PreparedT = TypeVar("PreparedT")
"""Result of preparing a change."""


class Changes(Generic[ParametersT, PreparedT]):
    """Answers requests to set a node's parameters.

    ROS itself refuses the read-only ones. A request that is refused here changes nothing.

    Args:
        node: its parameters are declared.
        parameters: what they are now.
        prepare: makes what new parameters need; what it raises refuses them.
        apply: gets the new parameters and what was prepared for them.
    """

    def __init__(
        self,
        node: Node,
        parameters: ParametersT,
        prepare: Callable[[ParametersT], PreparedT],
        apply: Callable[[ParametersT, PreparedT], None],
    ) -> None:
        self._node, self._parameters = node, parameters
        self._prepare, self._apply = prepare, apply
        self._defaults = {name: default for name, _, default in fields_of(type(parameters))}
        self._ready: tuple[ParametersT, PreparedT] | None = None
        node.add_pre_set_parameters_callback(self._with_floats)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._make_valid)

    def _with_floats(self, given: list[Parameter]) -> list[Parameter]:
        """Return the request with integers made floats where floats belong, as in files."""
        return [
            Parameter(entry.name, value=as_floats(entry.value, self._defaults.get(entry.name)))
            if entry.type_ in (Parameter.Type.INTEGER, Parameter.Type.INTEGER_ARRAY)
            else entry
            for entry in given
        ]

    def _check(self, given: list[Parameter]) -> SetParametersResult:
        self._ready = None
        values = {entry.name: plain(entry.value) for entry in given if entry.name in self._defaults}
        if not values:
            return SetParametersResult(successful=True)
        try:
            parameters = dataclasses.replace(self._parameters, **values)
            self._ready = parameters, self._prepare(parameters)
        except FnnEkfError as error:
            self._node.get_logger().warning(f"refused: {error}")
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _make_valid(self, given: list[Parameter]) -> None:
        if self._ready is None or not any(entry.name in self._defaults for entry in given):
            return
        before = self._parameters
        self._parameters, prepared = self._ready
        self._ready = None
        for name in self._defaults:
            old, new = getattr(before, name), getattr(self._parameters, name)
            if repr(old) != repr(new):
                self._node.get_logger().info(f"{name} is {_shown(new)} now, was {_shown(old)}")
        self._apply(self._parameters, prepared)


def as_floats(value: Any, default: Any) -> Any:
    """Return an integer, or a list of them, as floats if the default is of floats."""
    if isinstance(default, float):
        return float(value) if isinstance(value, int) else value
    if isinstance(default, tuple) and not isinstance(value, int):
        return [float(entry) for entry in value]
    return list(value) if hasattr(value, "__len__") else value


def _shown(value: Any) -> str:
    return str(list(value) if isinstance(value, tuple) else value)
