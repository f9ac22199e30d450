# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK: the shell may ask for completions

"""The executables: one table, one place where errors become one line."""

import argparse
import functools
import importlib
import os
import sys
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, redirect_stdout, suppress
from types import ModuleType
from typing import Any, NamedTuple

from fnn_ekf_ros.errors import FnnEkfError, in_one_line
from fnn_ekf_ros.stopping import FAILURE, INTERRUPTED, exit_by_signal, stop_by_signal
from fnn_ekf_ros.version import PACKAGE, version

COMPLETING = "_ARGCOMPLETE"
"""Environment variable that the shell sets if it asks for completions by argcomplete."""
HELP_WIDTH = 88
"""Width of the paragraphs of a help [characters]."""


class Command(NamedTuple):
    """An executable.

    Attributes:
        module: has `add_arguments(parser)`, which returns the parsers of subcommands if there are
            any, and `run(arguments)`.
        summary: what it does.
        examples: its arguments, as `--help` shows them; each subcommand's help those that begin
            with its name.
        is_node: whether `run` takes the list of ROS arguments instead.
        stops_by_signal: whether SIGINT and SIGTERM are a proper end, with exit code 0.
    """

    module: str
    summary: str
    examples: tuple[str, ...] = ()
    is_node: bool = False
    stops_by_signal: bool = False


COMMANDS = {
    "localizer": Command(
        "fnn_ekf_ros.ros.localizer",
        "the localizer node",
        (
            "--ros-args --params-file my_robot.yaml -r lrf_pose:=/amcl_pose -r compass:=/imu/data",
            "--ros-args -p wheel_radius:=0.025 -p wheel_separation:=0.6 "
            "-p encoder_counts_per_revolution:=500.0",
        ),
        is_node=True,
        stops_by_signal=True,
    ),
    "fake_robot": Command(
        "fnn_ekf_ros.ros.fake_robot",
        "a simulated robot as a node",
        ("", "--ros-args -p path:=figure_eight -p lrf_rate:=1.0 -p faults_file:=faults.yaml"),
        is_node=True,
        stops_by_signal=True,
    ),
    "simulate": Command(
        "fnn_ekf_ros.commands.simulate",
        "the simulated robot straight into a bag",
        ("run --duration 60", "run -p path:=round -p seed:=3 -p faults_file:=faults.yaml"),
    ),
    "play": Command(
        "fnn_ekf_ros.ros.play",
        "publish a recorded bag",
        (
            "my_bag --clock --loop",
            "my_bag --clock --rate 20 --keep-pace-with odom --topics joint_states compass lrf_pose",
        ),
        stops_by_signal=True,
    ),
    "replay": Command(
        "fnn_ekf_ros.commands.replay",
        "the localizer over a bag: bag in, bag out",
        (
            "run out --params run.yaml",
            "my_bag out --params my_robot.yaml -r lrf_pose:=/amcl_pose -r odom:=/odom_in_map --tf",
            "my_bag out --params my_robot.yaml --strict --json health.json --save-params new.yaml",
        ),
    ),
    "import-csv": Command(
        "fnn_ekf_ros.commands.import_csv",
        "a CSV recording into a bag",
        (
            "run.csv run --geometry run.json --fixes run_fixes.csv",
            "run.csv run --geometry run.json --fix-columns gps_x gps_y --compass-column yaw",
        ),
    ),
    "doctor": Command(
        "fnn_ekf_ros.commands.doctor",
        "what a bag holds, and what is wrong with the robot in it",
        (
            "my_bag",
            "my_bag --params my_robot.yaml -r lrf_pose:=/amcl_pose",
            "my_bag --params my_robot.yaml --json found.json --write-params mended.yaml",
        ),
    ),
    "tune": Command(
        "fnn_ekf_ros.commands.tune",
        "noise and calibration from bags without a ground truth",
        (
            "my_bag --params my_robot.yaml --output localizer.yaml",
            "mon tue --params my_robot.yaml --calibrate --output localizer.yaml --plot tuned.png",
        ),
    ),
    "evaluate": Command(
        "fnn_ekf_ros.commands.evaluate",
        "errors of a run, whether it is honest, and a report",
        (
            "out --align se2 --rpe 10m",
            "out other --truth-bag my_bag --labels joint EKF --json errors.json --plot errors.png",
            "out --report out.html --findings found.json",
            "out --tum files --kitti files",
        ),
    ),
    "compare": Command(
        "fnn_ekf_ros.commands.compare",
        "runs side by side, and which is better",
        (
            "out other --labels joint EKF --truth-bag my_bag --json compared.json",
            "my_bag --params a.yaml b.yaml -p adaptation:=joint -r lrf_pose:=/amcl_pose",
        ),
    ),
    "train": Command(
        "fnn_ekf_ros.commands.train",
        "learn the membership functions",
        ("--out trained.yaml --plots training", "--out joint.yaml --network joint --seed 2"),
    ),
    "study": Command(
        "fnn_ekf_ros.commands.study",
        "Monte Carlo runs through every filter",
        (
            "paper --out paper --runs 20",
            "grid --out grid --runs 10 --filters joint",
            "dynamic --out dynamic --runs 10 --filters joint -p lrf_pose_gate:=0.0",
            "real run --out real --params run.yaml",
            "faults --out faults --runs 2 --faults compass_nan,compass_frozen",
            "mistakes --out mistakes --seconds 70 --mistakes radius,compass_ned",
            "mistakes run --out mistakes",
            "rates --out rates --runs 4 --fixes 100",
            "lasting --out lasting --runs 4 --steps 200 --json -",
            "tune --out tune --runs 2 --kinds sim1,sim2",
            "tune run --out tune",
        ),
    ),
}
"""The executables, by name."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run `python3 -m fnn_ekf_ros NAME ...`; returns the exit code."""
    given = list(sys.argv[1:] if argv is None else argv)
    parser = argparse.ArgumentParser(
        prog=PACKAGE,
        description="Localization of two-wheeled robots by an EKF that estimates its noise.",
        epilog="NAME --help shows the arguments of a command, and examples.",
    )
    _add_version(parser, PACKAGE)
    names = parser.add_subparsers(metavar="NAME", required=True)
    asked = _asked_command()
    for name, command in COMMANDS.items():
        own = names.add_parser(name, help=command.summary, add_help=name == asked)
        if name == asked:
            _add_version(own, name)
            with suppress(FnnEkfError):  # ROS is not here
                _declare(own, name, command)
    _answer(parser)
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
    parser = argparse.ArgumentParser(prog=name, parents=[early])
    module = _declare(parser, name, command)
    _answer(parser)
    arguments = parser.parse_args(own)
    if command.is_node:
        return int(module.run(ros_arguments))
    with _messages_apart(arguments):
        return int(module.run(arguments))


def _messages_apart(arguments: argparse.Namespace) -> AbstractContextManager[Any]:
    """Send what is printed to stderr if a result goes to standard output."""
    results = vars(arguments).values()
    on_stdout = any(getattr(result, "stream", None) is not None for result in results)
    return redirect_stdout(sys.stderr) if on_stdout else nullcontext()


def _declare(parser: argparse.ArgumentParser, name: str, command: Command) -> ModuleType:
    """Declare the arguments of a command, and what its help says; return its module.

    Raises:
        FnnEkfError: it needs what is not installed.
    """
    parser.description = f"{command.summary[0].upper()}{command.summary[1:]}."
    if command.is_node:
        parser.usage = (
            "%(prog)s [-h] [--version] [--ros-args [-p NAME:=VALUE] [--params-file FILE] ...]"
        )
    module = importlib.import_module(command.module)
    below: Mapping[str, argparse.ArgumentParser] = module.add_arguments(parser) or {}
    _show_examples(parser, name, command, command.examples)
    for word, own in below.items():
        chosen = [each for each in command.examples if each.split()[0] == word]
        _show_examples(own, name, command, chosen)
    return module


def _show_examples(
    parser: argparse.ArgumentParser, name: str, command: Command, examples: Sequence[str]
) -> None:
    """Lay out a help, with examples at its end."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.description = _paragraph(parser.description or "")
    run = f"ros2 run {PACKAGE}" if command.is_node else f"python3 -m {PACKAGE}"
    shown = "\n".join(f"  {run} {name} {example}".rstrip() for example in examples)
    parser.epilog = f"{_paragraph(parser.epilog or '')}\n\nexamples:\n{shown}".strip()


def _paragraph(text: str) -> str:
    """Return a text for the help; one that has lines of its own keeps them."""
    return text if "\n" in text else textwrap.fill(text, HELP_WIDTH)


def _asked_command() -> str:
    """Return the command in the line that the shell wants to complete; empty if there is none."""
    words = os.environ.get("COMP_LINE", "").split() if COMPLETING in os.environ else []
    return next((word for word in words if word in COMMANDS), "")


def _answer(parser: argparse.ArgumentParser) -> None:
    """Answer the shell if it asks for completions, and end; nothing else imports argcomplete."""
    if COMPLETING not in os.environ:
        return
    try:
        from argcomplete import autocomplete
    except ImportError:
        sys.exit(FAILURE)  # a question is no order to run
    autocomplete(parser)


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
doctor = functools.partial(run_command, "doctor")
evaluate = functools.partial(run_command, "evaluate")
compare = functools.partial(run_command, "compare")
tune = functools.partial(run_command, "tune")
train = functools.partial(run_command, "train")
study = functools.partial(run_command, "study")
