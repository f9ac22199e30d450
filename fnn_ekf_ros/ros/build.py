# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""From message trees to the messages of rclpy."""

import functools
import importlib
from typing import Any

import numpy as np

from fnn_ekf_ros.messages import Message


@functools.cache
def message_class(type_name: str) -> Any:
    """Return the class of a type such as `nav_msgs/msg/Odometry`.

    Raises:
        ImportError: the type's package is not installed.
        AttributeError: the package has no such message.
    """
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def build_message(message: Message) -> Any:
    """Return the rclpy message of a tree."""
    fields = {name: _value(field) for name, field in message.fields.items()}
    if message.type_name == "diagnostic_msgs/msg/DiagnosticStatus":
        fields["level"] = bytes([fields["level"]])  # a `byte` is bytes of length 1 in rclpy
    return message_class(message.type_name)(**fields)


def _value(field: Any) -> Any:
    if isinstance(field, Message):
        return build_message(field)
    if isinstance(field, list):
        return [_value(entry) for entry in field]
    return field.tolist() if isinstance(field, np.ndarray) else field
