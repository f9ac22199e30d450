# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Command line arguments that several commands share, and checks of their values."""

import argparse
import functools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.files import (
    parse_assignment,
    read_parameter_file,
    refuse_what_ros_refuses,
)
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import Parameters, fields_of
from fnn_ekf_ros.recordings.inputs import TOPICS
from fnn_ekf_ros.study.workers import available_cpus

MOST_JOBS = 1024
"""Largest number of processes of `--jobs`: more than any machine has CPUs."""


class Range(NamedTuple):
    """The values that a number on the command line may have.

    Attributes:
        least: the smallest one.
        most: the largest one.
        unit: for the error message; empty for a count.
        excludes_least: whether it has to be more than `least`.
    """

    least: float
    most: float
    unit: str = ""
    excludes_least: bool = False

    def __contains__(self, value: object) -> bool:
        if not isinstance(value, int | float):
            return False
        enough = value > self.least if self.excludes_least else value >= self.least
        return enough and value <= self.most

    def __str__(self) -> str:
        least, most = _number(self.least), _number(self.most)
        words = f"{least} to {most}"
        if self.excludes_least:
            words = f"more than {least}, at most {most}"
        return f"{words} {self.unit}".rstrip()


def check_ranges(values: Mapping[str, Any], ranges: Mapping[str, Range]) -> None:
    """Check numbers of the command line.

    Args:
        values: of the options, by name with `_` for `-`.
        ranges: of those to check; one that has no value is passed over.

    Raises:
        FnnEkfError: a value is out of its range.
    """
    for name, allowed in ranges.items():
        value = values.get(name)
        if value is not None and value not in allowed:
            raise FnnEkfError(f"--{name.replace('_', '-')} {_number(value)}: expected {allowed}")


def chosen_names(option: str, words: str, known: Iterable[str]) -> list[str]:
    """Return the names that an option lists, separated by commas, in the order of `known`.

    Raises:
        FnnEkfError: a name that is not known.
    """
    names = list(known)
    chosen = [word.strip() for word in words.split(",")]
    for word in chosen:
        if word not in names:
            raise FnnEkfError(f"{option} {word}: expected some of {', '.join(names)}")
    return [name for name in names if name in chosen]


def add_parameter_arguments(
    parser: argparse.ArgumentParser, kind: type[Parameters] = LocalizerParameters
) -> None:
    """Add `--params FILE` and `-p name:=value` of a parameter set."""
    parser.add_argument(
        "--params", metavar="FILE", type=Path, action="append", default=[],
        help="parameter file in ROS form; may be given several times, later ones win",
    )  # fmt: skip
    assignments = parser.add_argument(
        "-p", dest="assignments", metavar="NAME:=VALUE", action="append", default=[],
        help="one parameter, as in ros2 run; wins over files",
    )  # fmt: skip
    assignments.completer = functools.partial(  # type: ignore[attr-defined]
        possible_assignments, kind
    )


def possible_assignments(kind: type[Parameters], prefix: str, **_: Any) -> list[str]:
    """Return how `-p` may go on, for the shell: names, then the words that a value may be.

    Args:
        kind: the parameter set.
        prefix: what there is of it.
    """
    name, separator, _value = prefix.partition(":=")
    if not separator:
        return [f"{known}:=" for known, _, _ in fields_of(kind)]
    words: tuple[str, ...] = ()
    for known, spec, default in fields_of(kind):
        if known == name:
            words = ("true", "false") if isinstance(default, bool) else spec.choices
    return [f"{name}:={word}" for word in words]


def possible_remappings(**_: Any) -> list[str]:
    """Return how `-r` may go on, for the shell: the topics that can have another name."""
    return [f"{topic}:=" for topic in TOPICS]


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


def add_remapping_argument(parser: argparse.ArgumentParser) -> None:
    """Add `-r FROM:=TO`."""
    remappings = parser.add_argument(
        "-r", dest="remappings", metavar="FROM:=TO", action="append", default=[],
        help="the recording's topic TO for the localizer's topic FROM, as in ros2 run",
    )  # fmt: skip
    remappings.completer = possible_remappings  # type: ignore[attr-defined]


def add_folder_argument(parser: argparse.ArgumentParser, results: str) -> None:
    """Add `--out DIR` of a study; `results` names what is written there."""
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True,
        help=f"folder for {results}; files of the same name are replaced",
    )  # fmt: skip


def add_json_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--json FILE` of a study."""
    parser.add_argument(
        "--json", metavar="FILE", type=Path, help="write the numbers here (DIR/results.json)"
    )


def add_seed_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--seed S` of a study."""
    parser.add_argument(
        "--seed", metavar="S", type=int, default=1, help="seed of all random numbers (1)"
    )


def add_jobs_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--jobs N`."""
    parser.add_argument(
        "--jobs", metavar="N", type=int, default=available_cpus(),
        help="processes at a time; results are the same for any number "
        "(%(default)s, the CPUs that may be used)",
    )  # fmt: skip


def given_jobs(arguments: argparse.Namespace) -> int:
    """Return the number of processes of `--jobs`.

    Raises:
        FnnEkfError: it is out of range.
    """
    check_ranges(vars(arguments), {"jobs": Range(1, MOST_JOBS)})
    return int(arguments.jobs)


def _number(value: float) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
