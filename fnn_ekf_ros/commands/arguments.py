# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Command line arguments that several commands share, and checks of their values."""

import argparse
import functools
from collections.abc import Iterable, Mapping, Sequence
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
from fnn_ekf_ros.recordings.bag_writer import file_beside
from fnn_ekf_ros.recordings.inputs import TOPICS
from fnn_ekf_ros.reports.results import check_results, text_result
from fnn_ekf_ros.study.workers import available_cpus


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


JOBS = Range(1, 1024)
"""Numbers of processes of `--jobs`: at most more than any machine has CPUs."""
SEEDS = Range(0, 2**63 - 1)
"""Seeds of a study, as many as an integer of numpy has."""


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


def recorded_parameters(
    arguments: argparse.Namespace, bag: Path, node_name: str
) -> tuple[dict[str, Any], list[str]]:
    """Return parameters for a recording, and the names of the files beside it that they are from.

    Those of `NAME.yaml` beside `NAME` hold unless `--params` and `-p` say otherwise.

    Raises:
        ParameterError: a file or an assignment that cannot be read.
    """
    values: dict[str, Any] = {}
    files = []
    beside = file_beside(bag.with_suffix("") if bag.is_file() else bag)
    if beside.exists():
        values = read_parameter_file(beside, node_name)
        files.append(beside.name)
    return values | given_parameters(arguments, node_name), files


def add_remapping_argument(parser: argparse.ArgumentParser) -> None:
    """Add `-r FROM:=TO`."""
    remappings = parser.add_argument(
        "-r", dest="remappings", metavar="FROM:=TO", action="append", default=[],
        help="the recording's topic TO for the localizer's topic FROM, as in ros2 run",
    )  # fmt: skip
    remappings.completer = possible_remappings  # type: ignore[attr-defined]


class Count(NamedTuple):
    """A whole number that a study is asked for.

    Attributes:
        name: of the option, without dashes.
        default: its default.
        allowed: its range.
        help: what is counted.
    """

    name: str
    default: int
    allowed: Range
    help: str


def runs_count(default: int, words: str) -> Count:
    """Return `--runs N` of a study whose tables have confidence intervals: of two runs at least."""
    return Count("runs", default, Range(2, 10_000), words)


def add_study_arguments(
    parser: argparse.ArgumentParser, results: str, counts: Sequence[Count] = ()
) -> None:
    """Add what every study of simulated robots has.

    Args:
        parser: of the study.
        results: what is written to the folder of `--out`, in words.
        counts: the study's own numbers.
    """
    add_study_results(parser, results)
    for count in counts:
        parser.add_argument(
            f"--{count.name}", metavar="N", type=int, default=count.default,
            help=f"{count.help} ({count.default})",
        )  # fmt: skip
    parser.add_argument(
        "--seed", metavar="S", type=int, default=1, help="seed of all random numbers (1)"
    )
    parser.add_argument(
        "--jobs", metavar="N", type=int, default=available_cpus(),
        help="processes at a time; results are the same for any number "
        "(%(default)s, the CPUs that may be used)",
    )  # fmt: skip
    add_parameter_arguments(parser)


def check_study_arguments(arguments: argparse.Namespace, counts: Sequence[Count] = ()) -> None:
    """Check the numbers that `add_study_arguments` has declared.

    Raises:
        FnnEkfError: one is out of its range.
    """
    ranges = {count.name.replace("-", "_"): count.allowed for count in counts} | {
        "seed": SEEDS,
        "jobs": JOBS,
    }
    check_ranges(vars(arguments), ranges)


def add_study_results(parser: argparse.ArgumentParser, results: str) -> None:
    """Add `--out DIR`, `--json FILE` and `--force` of a study; `results` names what is written."""
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True, help=f"new folder for {results}"
    )
    add_text_argument(parser, "--json", "write the numbers as JSON", "DIR/results.json")
    add_force_argument(parser)


def add_text_argument(
    parser: argparse.ArgumentParser,
    option: str,
    words: str,
    default: str = "",
    *,
    required: bool = False,
) -> None:
    """Add an option for the file of a text, which may be standard output.

    Args:
        parser: of the command.
        option: such as `--json`.
        words: what is written there.
        default: where it is written without the option, in words; empty for nowhere.
        required: whether the option has to be given.
    """
    without = f" ({default})" if default else ""
    parser.add_argument(
        option, metavar="FILE", type=text_result, required=required,
        help=f"{words}{without}; - for standard output, and everything else on stderr",
    )  # fmt: skip


def add_force_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--force`."""
    parser.add_argument(
        "--force", action="store_true", help="replace results that are there already"
    )


def check_command_results(
    arguments: argparse.Namespace, options: Iterable[str], inputs: Iterable[Path]
) -> None:
    """Check the files that a command was asked to write.

    Args:
        arguments: of the command, with `force`.
        options: those that name a file to write, such as `--json`.
        inputs: what the command reads, and other places of results.

    Raises:
        FnnEkfError: one cannot be written.
    """
    results = {option: getattr(arguments, option[2:].replace("-", "_")) for option in options}
    check_results(results, inputs, replaces=arguments.force)


def _number(value: float) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
