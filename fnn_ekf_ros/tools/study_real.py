"""`study real BAG...`: every start of the localizer on recordings with a ground truth."""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.bag_files import BagError, BagReader, file_beside
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.state import FilterModel
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.files import (
    parse_assignment,
    read_parameter_file,
    render_parameter_file,
)
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import ParameterError, build
from fnn_ekf_ros.pipeline.start import Waiting
from fnn_ekf_ros.study.filters import EKF, JOINT, SET_BY_NAMES, localizer_models
from fnn_ekf_ros.study.real import (
    BatchStart,
    Run,
    batch_start,
    collect,
    diverged,
    recording_pipeline,
    rows_measured,
    run_starts,
    score_starts,
    with_noise_of,
)
from fnn_ekf_ros.study.starts import ALL_CELLS
from fnn_ekf_ros.text_files import write_text
from fnn_ekf_ros.tools.arguments import add_parameter_arguments, given_parameters
from fnn_ekf_ros.tools.bag_inputs import (
    TopicNames,
    add_remapping_argument,
    inputs_in,
    last_words,
    read_events,
)
from fnn_ekf_ros.tools.evaluate import read_track
from fnn_ekf_ros.tools.pictures import require_matplotlib
from fnn_ekf_ros.tools.progress import with_progress
from fnn_ekf_ros.tools.result_folder import prepare_study
from fnn_ekf_ros.tools.scoring import interpolate
from fnn_ekf_ros.tools.study_real_figures import draw_real
from fnn_ekf_ros.tools.study_real_tables import BagResult, FilterResult, real_tables, rows
from fnn_ekf_ros.tools.study_tables import start_words
from fnn_ekf_ros.version import version

NAME = "real"
SUMMARY = "recordings with a ground truth, from 25 starts with wrong noise"


class _Recording(NamedTuple):
    """A bag, ready to be run.

    Attributes:
        label: the bag's name.
        parameters: of the localizer; their noise is what a factor of 1 stands for.
        parameter_files: where they are from.
        batch: starts and periods.
        truth: `(T, 3)` true poses at the start and at each period's end; NaN where not known.
    """

    label: str
    parameters: LocalizerParameters
    parameter_files: list[str]
    batch: BatchStart
    truth: FloatArray


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "bags", metavar="BAG", type=Path, nargs="+",
        help="recordings; NAME.yaml beside NAME holds its localizer parameters",
    )  # fmt: skip
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True,
        help="folder for tables, figures and settings; files of the same name are replaced",
    )  # fmt: skip
    parser.add_argument(
        "--truth-topic", default="/ground_truth", metavar="TOPIC", help="(/ground_truth)"
    )
    parser.add_argument(
        "--filters", metavar="A,B", default=JOINT,
        help=f"the localizer's filters beside the EKF, by name ({JOINT})",
    )  # fmt: skip
    parser.add_argument(
        "--json", metavar="FILE", type=Path, help="write the numbers here (DIR/results.json)"
    )
    add_parameter_arguments(parser)
    add_remapping_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    require_matplotlib()
    for text in arguments.assignments:
        name, _ = parse_assignment(text)
        if name in SET_BY_NAMES:
            raise FnnEkfError(f"parameter '{name}': the filters' names decide on it")
    labels = [path.stem if path.is_file() else path.resolve().name for path in arguments.bags]
    if len(set(labels)) < len(labels):
        raise FnnEkfError(f"{', '.join(labels)}: expected bags of different names")
    out = arguments.out
    settings = [_parameters(path, arguments) for path in arguments.bags]
    names = [EKF, *_chosen(arguments.filters, list(localizer_models(settings[0][0])))]
    recordings = [
        _read(path, label, *each, arguments)
        for path, label, each in zip(arguments.bags, labels, settings, strict=True)
    ]
    inputs = [*arguments.bags, *arguments.params]
    numbers = prepare_study(out, ["results.md"], arguments.json, inputs)

    made_by = {
        "study": NAME, "version": version(), "filters": names[1:],
        "parameters": dict(parse_assignment(text) for text in arguments.assignments),
    }  # fmt: skip
    results = [_result(recording, names) for recording in recordings]
    content = {**made_by, "bags": [rows(result) for result in results]}
    write_text(numbers, json.dumps(content, indent=1, allow_nan=False) + "\n")
    write_text(out / "results.md", real_tables(made_by, results))
    for recording, result in zip(recordings, results, strict=True):
        values = asdict(recording.parameters)
        text = render_parameter_file(LocalizerParameters, values, NODE_NAME)
        write_text(out / f"localizer_{result.label}.yaml", text)
        draw_real(out / f"real_{result.label}.png", result)
    print(f"{out}: {', '.join(labels)} from {len(ALL_CELLS)} starts, {', '.join(names)}")
    print(f"{out / 'results.md'}: the tables")
    return 0


def _parameters(path: Path, arguments: argparse.Namespace) -> tuple[LocalizerParameters, list[str]]:
    """Return the parameters for a bag, and the files they are from; the given ones win."""
    values: dict[str, Any] = {}
    files = []
    beside = file_beside(path.with_suffix("") if path.is_file() else path)
    if beside.exists():
        values = read_parameter_file(beside, NODE_NAME)
        files.append(beside.name)
    values |= given_parameters(arguments, NODE_NAME)
    for name in SET_BY_NAMES:
        values.pop(name, None)
    parameters = build(LocalizerParameters, values)
    for cell in ALL_CELLS:
        try:
            with_noise_of(parameters, cell)
        except ParameterError as error:
            raise ParameterError(f"bag '{path}', {start_words(cell)}: {error}") from None
    return parameters, [*files, *(str(p) for p in arguments.params)]


def _chosen(words: str, known: list[str]) -> list[str]:
    possible = [name for name in known if name != EKF]
    chosen = [word.strip() for word in words.split(",")]
    for word in chosen:
        if word not in known:
            raise FnnEkfError(f"--filters {word}: expected some of {', '.join(possible)}")
    return [name for name in possible if name in chosen]


def _read(
    path: Path,
    label: str,
    parameters: LocalizerParameters,
    files: list[str],
    arguments: argparse.Namespace,
) -> _Recording:
    """Take a bag through the pipeline once, for its periods."""
    pipeline, recorder = recording_pipeline(parameters)
    names = TopicNames(arguments.remappings)
    with BagReader(path) as bag:
        truth = read_track(bag, arguments.truth_topic)
        inputs = inputs_in(bag, parameters, names)
        for record in with_progress(bag.records(), bag.message_count, f"{label}: reading"):
            if record.topic in inputs:
                for event in read_events(pipeline, bag, record, inputs[record.topic]):
                    pipeline.add(event, record.time_ns)
            pipeline.advance(record.time_ns)
    periods = recorder.periods
    if recorder.broken_ns is not None:
        raise BagError(
            f"bag '{path}': the localizer starts anew at {recorder.broken_ns * 1e-9:.3f} s; "
            "expected a recording without jumps of the clock"
        )
    if not periods or isinstance(periods[-1].after, Waiting):
        raise BagError(
            f"bag '{path}' gives no odom: expected encoders, fixes and a yaw that start the "
            f"filter; {last_words(pipeline)}"
        )
    batch = batch_start(parameters, periods, ALL_CELLS)
    true_pose = np.full((1 + len(batch.inputs), 3), np.nan)
    if len(truth.time_ns) > 1:
        true_pose = interpolate(truth, np.array([batch.stamp_ns, *batch.stamps_ns]))
    if not np.any(np.isfinite(true_pose[1:, 0])):
        raise BagError(f"bag '{path}': odom and {arguments.truth_topic} have no time in common")
    return _Recording(label, parameters, files, batch, true_pose)


def _result(recording: _Recording, names: Sequence[str]) -> BagResult:
    """Run the filters and score them."""
    models = localizer_models(recording.parameters)
    runs = {name: _run(recording, name, models[name].model) for name in names}
    scores = {name: score_starts(each, recording.truth) for name, each in runs.items()}
    best = float(np.min(scores[EKF].position))
    filters = []
    for name, ended in runs.items():
        found = scores[name].position
        if name != EKF:
            start = recording.batch.start._replace(
                process_noise=ended.process_noise, measurement_noise=ended.measurement_noise
            )
            again = recording._replace(batch=recording.batch._replace(start=start))
            rerun = _run(again, f"EKF on noise of {name}", models[EKF].model)
            found = score_starts(rerun, recording.truth).position
        filters.append(
            FilterResult(
                name=name,
                label=models[name].label,
                score=scores[name],
                diverged=diverged(scores[name], best),
                process_noise_std=np.sqrt(ended.process_noise),
                measurement_noise_std=np.sqrt(ended.measurement_noise),
                position_with_noise_found=found,
            )
        )
    p, stamps = recording.parameters, recording.batch.stamps_ns
    return BagResult(
        label=recording.label,
        parameter_files=tuple(recording.parameter_files),
        process_noise_std=p.process_noise_std,
        measurement_noise_std=(*p.measurement_noise_std, p.lrf_yaw_std),
        rows=rows_measured(recording.batch),
        duration_s=1e-9 * (stamps[-1] - recording.batch.stamp_ns),
        estimates=len(recording.truth),
        scored=int(np.sum(np.isfinite(recording.truth[:, 0]))),
        best_position=best,
        filters=tuple(filters),
    )


def _run(recording: _Recording, name: str, model: FilterModel) -> Run:
    batch = recording.batch
    states = run_starts(model, batch)
    try:
        return collect(with_progress(states, len(recording.truth), f"{recording.label}: {name}"))
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise FnnEkfError(f"'{recording.label}': the filter {name} failed ({error})") from None
