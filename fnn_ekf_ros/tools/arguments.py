"""Command line arguments that several commands share."""

import argparse
import re
from pathlib import Path
from typing import Any

from fnn_ekf_ros.parameters.files import (
    parse_assignment,
    read_parameter_file,
    refuse_what_ros_refuses,
)


def add_parameter_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--params FILE` and `-p name:=value`."""
    parser.add_argument(
        "--params", metavar="FILE", type=Path, action="append", default=[],
        help="parameter file in ROS form; may be given several times, later ones win",
    )  # fmt: skip
    parser.add_argument(
        "-p", dest="assignments", metavar="NAME:=VALUE", action="append", default=[],
        help="one parameter, as in ros2 run; wins over files",
    )  # fmt: skip


def given_parameters(arguments: argparse.Namespace, node_name: str) -> dict[str, Any]:
    """Return what `--params` and `-p` say, checked only for what ROS would not take.

    Raises:
        ParameterError: a file or an assignment that cannot be read.
    """
    values: dict[str, Any] = {}
    for path in arguments.params:
        values.update(read_parameter_file(path, node_name))
    values.update(parse_assignment(text) for text in arguments.assignments)
    refuse_what_ros_refuses(values)
    return values


def readable(text: str) -> str:
    """Return a name that can be printed: U+FFFD stands for bytes that are not UTF-8."""
    return re.sub("[\ud800-\udfff]", "\N{REPLACEMENT CHARACTER}", text)
