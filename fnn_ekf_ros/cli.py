# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The executables: one table, one place where errors become one line."""

import argparse
import functools
import importlib
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from fnn_ekf_ros.errors import FnnEkfError, in_one_line
from fnn_ekf_ros.stopping import FAILURE, INTERRUPTED, exit_by_signal, stop_by_signal
from fnn_ekf_ros.version import PACKAGE, version


class Command(NamedTuple):
    """An executable.

    Attributes:
        module: has `add_arguments(parser)` and `run(arguments)`.
        summary: what it does.
        is_node: whether `run` takes the list of ROS arguments instead.
        stops_by_signal: whether SIGINT and SIGTERM are a proper end, with exit code 0.
    """

    module: str
    summary: str
    is_node: bool = False
    stops_by_signal: bool = False


COMMANDS = {
    "localizer": Command(
        "fnn_ekf_ros.ros.localizer", "the localizer node", is_node=True, stops_by_signal=True
    ),
    "fake_robot": Command(
        "fnn_ekf_ros.ros.fake_robot",
        "a simulated robot as a node",
        is_node=True,
        stops_by_signal=True,
    ),
    "simulate": Command("fnn_ekf_ros.commands.simulate", "the simulated robot straight into a bag"),
    "play": Command("fnn_ekf_ros.ros.play", "publish a recorded bag", stops_by_signal=True),
    "replay": Command("fnn_ekf_ros.commands.replay", "the localizer over a bag: bag in, bag out"),
    "import-csv": Command("fnn_ekf_ros.commands.import_csv", "a CSV recording into a bag"),
    "evaluate": Command("fnn_ekf_ros.commands.evaluate", "errors against a ground truth"),
    "train": Command("fnn_ekf_ros.commands.train", "learn the membership functions"),
    "study": Command("fnn_ekf_ros.commands.study", "Monte Carlo runs through every filter"),
}
"""The executables, by name."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run `python3 -m fnn_ekf_ros NAME ...`; returns the exit code."""
    given = list(sys.argv[1:] if argv is None else argv)
    parser = argparse.ArgumentParser(
        prog=PACKAGE,
        description="Localization of two-wheeled robots by an EKF that estimates its noise.",
        epilog="NAME --help shows the arguments of a command.",
    )
    _add_version(parser, PACKAGE)
    names = parser.add_subparsers(metavar="NAME", required=True)
    for name, command in COMMANDS.items():
        names.add_parser(name, help=command.summary, add_help=False)
    if not given or given[0] not in COMMANDS:
        parser.parse_args(given)
    return run_command(given[0], given[1:])


def run_command(name: str, argv: Sequence[str] | None = None) -> int:
    """Run one executable; returns the exit code.

    A `FnnEkfError` ends here, as one line on stderr; so do a full disk and a lack of memory.
    """
    given = list(sys.argv[1:] if argv is None else argv)
    try:
        try:
            return _run(name, COMMANDS[name], given)
        finally:
            print(end="", flush=True)  # what cannot be written is reported here, not at exit
    except FnnEkfError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return FAILURE
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:  # the reader of the output has ended
        _discard_output()
        return FAILURE
    except MemoryError:
        print(f"{name}: out of memory", file=sys.stderr)
        return FAILURE
    except OSError as error:
        print(f"{name}: {in_one_line(error)}", file=sys.stderr)
        _discard_output()
        return FAILURE


def _run(name: str, command: Command, given: list[str]) -> int:
    stop_by_signal() if command.stops_by_signal else exit_by_signal()
    own, ros_arguments = _split(given) if command.is_node else (given, [])
    # Nodes print their version without ROS, too: before their module is imported.
    early = argparse.ArgumentParser(prog=name, add_help=False, allow_abbrev=False)
    _add_version(early, f"{name} ({PACKAGE})")
    early.parse_known_args(own)
    summary = f"{command.summary[0].upper()}{command.summary[1:]}."
    parser = argparse.ArgumentParser(prog=name, description=summary, parents=[early])
    if command.is_node:
        parser.usage = (
            "%(prog)s [-h] [--version] [--ros-args [-p NAME:=VALUE] [--params-file FILE] ...]"
        )
    module = importlib.import_module(command.module)
    module.add_arguments(parser)
    arguments = parser.parse_args(own)
    return int(module.run(ros_arguments if command.is_node else arguments))


def _discard_output() -> None:
    """Send what is still to be written nowhere, so that Python does not fail on it at exit."""
    with suppress(AttributeError, OSError):  # no stdout, or one that is no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _Version(argparse.Action):
    """Prints name and version; the version is looked up only then."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        print(f"{self.metavar} {version()}")
        parser.exit()


def _add_version(parser: argparse.ArgumentParser, name: str) -> None:
    parser.add_argument(
        "--version", action=_Version, nargs=0, metavar=name, help="show the version and exit"
    )


def _split(argv: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return a node's own arguments and its ROS arguments, `--ros-args ... [--]`."""
    own: list[str] = []
    ros: list[str] = []
    in_ros = False
    for argument in argv:
        if argument == "--ros-args":
            in_ros = True
        (ros if in_ros else own).append(argument)
        if argument == "--":
            in_ros = False
    return own, ros


localizer = functools.partial(run_command, "localizer")
fake_robot = functools.partial(run_command, "fake_robot")
simulate = functools.partial(run_command, "simulate")
play = functools.partial(run_command, "play")
replay = functools.partial(run_command, "replay")
import_csv = functools.partial(run_command, "import-csv")
evaluate = functools.partial(run_command, "evaluate")
train = functools.partial(run_command, "train")
study = functools.partial(run_command, "study")
