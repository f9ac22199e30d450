# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`tune BAG...`: noise, lasting errors and calibration from recordings without a ground truth."""

import argparse
import math
import sys
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fnn_ekf_ros.commands.arguments import (
    add_force_argument,
    add_parameter_arguments,
    add_remapping_argument,
    add_text_argument,
    check_command_results,
    given_parameters,
)
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.files import read_parameter_file, render_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.recordings.bag_files import check_bags
from fnn_ekf_ros.recordings.bag_writer import file_beside
from fnn_ekf_ros.reports.pictures import require_matplotlib
from fnn_ekf_ros.reports.tuning_figure import ProfilePanel, draw_profiles
from fnn_ekf_ros.study.real import batch_start
from fnn_ekf_ros.study.real_bags import read_periods
from fnn_ekf_ros.study.starts import RIGHT
from fnn_ekf_ros.tuning.quantities import is_logarithm
from fnn_ekf_ros.tuning.recording import TuningRecording, prepare
from fnn_ekf_ros.tuning.tune import Tuned, tune
from fnn_ekf_ros.tuning.words import Line, changes, lines, remarks, table
from fnn_ekf_ros.version import version


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "bags", metavar="BAG", type=Path, nargs="+",
        help="recordings of one robot; NAME.yaml beside NAME holds its localizer parameters",
    )  # fmt: skip
    add_text_argument(parser, "--output", "write the localizer's parameters (YAML)")
    parser.add_argument(
        "--calibrate", action="store_true",
        help="find wheel radius, separation, compass offset and delays, too",
    )  # fmt: skip
    parser.add_argument(
        "--plot", metavar="PNG", type=Path, help="draw how well each quantity is known"
    )
    add_text_argument(parser, "--json", "write the numbers as JSON")
    add_force_argument(parser)
    add_parameter_arguments(parser)
    add_remapping_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_bags(arguments.bags)
    inputs = [*arguments.bags, *arguments.params]
    check_command_results(arguments, ["--output", "--plot", "--json"], inputs)
    if arguments.plot is not None:
        require_matplotlib()
    recordings = _read(arguments)
    passes = _Passes()
    tuned = tune(recordings, calibrates=arguments.calibrate, progress=passes)
    passes.end()
    shown = lines(tuned, tuned.shown)
    said = remarks(recordings, tuned)
    labels = ", ".join(recording.label for recording in recordings)
    print(f"{labels}: {'errors that last' if tuned.errors_last else 'white errors'}")
    print(table(shown))
    if tuned.errors_last:
        print("\nfor the parameters, which take all errors for white:")
        print(changes(tuned))
    print("\n" + "\n".join(said))
    _write(arguments, labels, tuned, shown, said)
    return 0


def _read(arguments: argparse.Namespace) -> list[TuningRecording]:
    """Return the recordings.

    Raises:
        FnnEkfError: they are of different robots, or one cannot be used.
    """
    paths: list[Path] = arguments.bags
    first, *others = parameters = [_parameters(path, arguments) for path in paths]
    for path, other in zip(paths[1:], others, strict=True):
        if other != first:
            raise FnnEkfError(
                f"{_label(paths[0])} and {_label(path)} have different parameters: expected "
                "recordings of one robot, or --params for all"
            )
    recordings = []
    for path, own in zip(paths, parameters, strict=True):
        periods = read_periods(path, _label(path), own, arguments.remappings)
        recordings.append(prepare(_label(path), own, batch_start(own, periods, [RIGHT])))
    return recordings


def _label(path: Path) -> str:
    return path.stem if path.is_file() else path.resolve().name


def _parameters(path: Path, arguments: argparse.Namespace) -> LocalizerParameters:
    """Return the parameters for a bag; the given ones win over those beside it."""
    values: dict[str, Any] = {}
    beside = file_beside(path.with_suffix("") if path.is_file() else path)
    if beside.exists():
        values = read_parameter_file(beside, NODE_NAME)
    return build(LocalizerParameters, values | given_parameters(arguments, NODE_NAME))


class _Passes:
    """Says on a terminal what is being done."""

    def __init__(self) -> None:
        self._count = 0
        self._terminal = sys.stderr.isatty()

    def __call__(self, text: str) -> None:
        self._count += 1
        if self._terminal:
            print(f"\r\033[Kpass {self._count}: {text}", end="", file=sys.stderr, flush=True)

    def end(self) -> None:
        """Remove the last line."""
        if self._terminal:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def _write(
    arguments: argparse.Namespace, labels: str, tuned: Tuned, shown: list[Line], said: list[str]
) -> None:
    """Write what the options ask for."""
    if arguments.output is not None:
        head = "\n".join([f"Parameters for {labels}, found by tune ({version()}).", *said])
        text = render_parameter_file(LocalizerParameters, asdict(tuned.after), NODE_NAME, head)
        arguments.output.write(text)
        print(f"{arguments.output}: the parameters")
    if arguments.json is not None:
        arguments.json.write_json(_numbers(labels, tuned, said))
    if arguments.plot is not None:
        draw_profiles(arguments.plot, labels, list(_panels(tuned, shown)))
        print(f"{arguments.plot}: the log likelihood along each quantity")


def _panels(tuned: Tuned, shown: list[Line]) -> Iterable[ProfilePanel]:
    for line, profile in zip(shown, tuned.shown.profiles, strict=True):
        value = tuned.shown.fit.values[profile.quantity]
        size = line.found / value if is_logarithm(profile.quantity) else 1.0
        start = 0.0 if is_logarithm(profile.quantity) else line.found - value
        yield ProfilePanel(
            title=f"{line.name} [{line.unit}]" if line.unit else line.name,
            values=start + size * profile.values,
            log_likelihood=profile.log_likelihood,
            found=line.found,
            now=line.now,
            logarithmic=is_logarithm(profile.quantity),
        )


def _numbers(labels: str, tuned: Tuned, said: list[str]) -> dict[str, Any]:
    """Return the results as JSON can hold them."""
    return {
        "version": version(),
        "recordings": labels,
        "errors_last": tuned.errors_last,
        "models": {
            name: {
                "next_readings_trusted": model.fit.trusts_next_readings,
                "log_likelihood": [float(value) for value in model.fit.slopes.value],
                "quantities": [_plain(line) for line in lines(tuned, model)],
            }
            for name, model in (("white", tuned.white), ("lasting", tuned.lasting))
        },
        "parameters": {name: _known(value) for name, value in asdict(tuned.after).items()},
        "remarks": said,
    }


def _plain(line: Line) -> dict[str, Any]:
    return {key: _known(value) for key, value in line._asdict().items()}


def _known(value: Any) -> Any:
    """Return a value with null for each number that is not known."""
    if isinstance(value, tuple):
        return [_known(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
