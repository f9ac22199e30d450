# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The common part of all nodes of the package: start, parameters, spin, stop."""

import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.files import (
    parse_assignment,
    read_parameter_file,
    refuse_what_ros_refuses,
)
from fnn_ekf_ros.parameters.schema import ParameterError, Parameters, build, fields_of
from fnn_ekf_ros.stopping import STOPPED

try:
    import rclpy
    from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
    from rclpy.clock import Clock, ClockType
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.parameter import Parameter
    from rclpy.signals import SignalHandlerOptions
except ImportError as error:
    raise FnnEkfError(
        f"ROS 2 is not here ({error}): source a ROS 2 Jazzy installation first, or install the "
        "ros-jazzy-rclpy, ros-jazzy-rmw-fastrtps-cpp and ros-jazzy-common-interfaces wheels"
    ) from None

LOG_INTERVAL_S = 10.0
"""A trouble that lasts is logged this often [s]."""
SIGNAL_INTERVAL_S = 0.2
"""A node sees a signal at the latest after this time [s]."""
ParametersT = TypeVar("ParametersT", bound=Parameters)
"""A dataclass of parameters."""


def check_ros_arguments(argv: Sequence[str], node_name: str) -> None:
    """Refuse parameters that rcl would refuse without saying which, or accept in silence.

    Raises:
        ParameterError: a file that cannot be read, a value that is missing, a list of mixed types.
    """
    given: dict[str, Any] = {}
    for option, value in itertools.pairwise(argv):
        if option == "--params-file":
            given.update(read_parameter_file(Path(value), node_name, has_section=False))
        elif option in ("-p", "--param"):
            name, content = parse_assignment(value)
            given[name] = content
    refuse_what_ros_refuses(given)


@contextmanager
def ros_started(argv: Sequence[str], node_name: str) -> Iterator[None]:
    """Initialize rclpy with ROS arguments; shut it down at the end.

    Raises:
        FnnEkfError: rclpy refuses the arguments.
    """
    check_ros_arguments(argv, node_name)
    try:
        rclpy.init(args=["", *argv], signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # RCLError is private to rclpy
        raise FnnEkfError(f"ROS refuses the arguments: {_first_line(error)}") from None
    try:
        yield
    finally:
        rclpy.try_shutdown()


def parameters_from_ros(node_name: str) -> dict[str, Any]:
    """Return the parameters that the ROS arguments hold for a node, whatever their names.

    rclpy passes over unknown names in silence, and ends in a traceback on a wrong type. A short
    lived node without any endpoint declares what it is given; the real one checks it first.

    Raises:
        ParameterError: a parameter without a value.
    """
    try:
        probe = Node(
            node_name,
            enable_rosout=False,
            start_parameter_services=False,
            automatically_declare_parameters_from_overrides=True,
        )
    except ValueError as error:
        raise ParameterError(f"a parameter has no value: {_first_line(error)}") from None
    try:
        found = probe.get_parameters_by_prefix("")
        return {name: plain(entry.value) for name, entry in found.items()}
    finally:
        probe.destroy_node()


def checked_parameters(
    kind: type[ParametersT], ros_arguments: Sequence[str], node_name: str
) -> ParametersT:
    """Return the parameter set that the ROS arguments hold for a node.

    Args:
        kind: the set.
        ros_arguments: with which ROS was started.
        node_name: the node's name, if they give it no other.

    Raises:
        ParameterError: a parameter is wrong or not set; files for other nodes are named.
    """
    try:
        return build(kind, parameters_from_ros(node_name))
    except ParameterError as error:
        said = [str(error), *_files_for_others(ros_arguments, node_name)]
        raise ParameterError("; ".join(said)) from None


def _files_for_others(ros_arguments: Sequence[str], node_name: str) -> Iterator[str]:
    """Yield a sentence for each parameter file that ROS passes over because of the node's name."""
    pairs = list(itertools.pairwise(ros_arguments))
    for option, value in pairs:
        renamed = re.search(r"(?:^|:)__node:=(\w+)$", value)
        if option in ("-r", "--remap") and renamed:
            node_name = renamed[1]
    for option, value in pairs:
        if option == "--params-file":
            try:
                read_parameter_file(Path(value), node_name)
            except ParameterError as error:
                yield str(error)


def as_overrides(parameters: Parameters) -> list[Parameter]:
    """Return checked parameters as overrides for a node's constructor."""
    return [
        Parameter(name, value=_ros_value(getattr(parameters, name)))
        for name, _, _ in fields_of(type(parameters))
    ]


def declare(node: Node, kind: type[Parameters]) -> None:
    """Declare a set's parameters with their descriptions and ranges.

    They are read-only but for those that can change at run time (`changes`).
    """
    for name, spec, default in fields_of(kind):
        descriptor = ParameterDescriptor(description=spec.doc, read_only=not spec.at_run_time)
        unit = f"unit {spec.unit}" if spec.unit else ""
        choices = f"one of {', '.join(spec.choices)}" if spec.choices else ""
        limits = spec.limits if isinstance(default, tuple) else ""
        descriptor.additional_constraints = "; ".join(filter(None, [choices, limits, unit]))
        if isinstance(default, float):
            span = FloatingPointRange(from_value=spec.at_least, to_value=spec.at_most)
            descriptor.floating_point_range = [span]
        elif isinstance(default, int) and not isinstance(default, bool):
            descriptor.integer_range = [
                IntegerRange(from_value=int(spec.at_least), to_value=int(spec.at_most), step=1)
            ]
        node.declare_parameter(name, _ros_value(default), descriptor)


def spin_until_stopped(make_node: Callable[[], Node]) -> int:
    """Make a node and run it until SIGINT or SIGTERM; returns the exit code, 0.

    The signal handlers are ours (`stop_by_signal`): with rclpy's own, a busy node now and then
    ends in a traceback.
    """
    try:
        node = make_node()
    except FnnEkfError:
        raise
    except Exception as error:  # what rclpy makes of a wrong qos_overrides, for one
        raise FnnEkfError(f"the node cannot start: {_first_line(error)}") from None
    # Python sees a signal when a wait ends; a time limit would cost a new timer at each message.
    node.create_timer(SIGNAL_INTERVAL_S, _wake, clock=Clock(clock_type=ClockType.STEADY_TIME))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while not STOPPED.is_set():
            try:
                executor.spin_once()
            except ExternalShutdownException:
                break
            except Exception as error:  # a node must not die of a message, such as a wrong /clock
                node.get_logger().error(
                    f"{type(error).__name__}: {error}; carrying on",
                    throttle_duration_sec=LOG_INTERVAL_S,
                )
                STOPPED.wait(0.01)
    finally:
        executor.shutdown()
        node.destroy_node()
    return 0


def _wake() -> None:
    """Do nothing: that the executor has woken up is enough."""


def plain(value: Any) -> Any:
    """Return the value of a ROS parameter as parameter sets have it: lists as tuples."""
    return tuple(value) if hasattr(value, "__len__") and not isinstance(value, str) else value


def _ros_value(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _first_line(error: Exception) -> str:
    lines = str(error).splitlines()
    return lines[0] if lines else type(error).__name__
