# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`evaluate BAG...`: errors of recorded odom, whether its covariance is honest, and a report."""

import argparse
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from fnn_ekf_ros import messages
from fnn_ekf_ros.commands.arguments import (
    add_force_argument,
    add_text_argument,
    check_command_results,
)
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.evaluation.alignment import Alignment, aligned_track
from fnn_ekf_ros.evaluation.errors import parse_delta
from fnn_ekf_ros.evaluation.evaluation import (
    Evaluation,
    evaluate,
    plain,
    plain_run,
    sentences,
)
from fnn_ekf_ros.evaluation.export import kitti_text, tum_text
from fnn_ekf_ros.files.text_files import readable, write_text
from fnn_ekf_ros.recordings.bag_files import BagError, BagReader, check_bags
from fnn_ekf_ros.recordings.run_record import RunRecord
from fnn_ekf_ros.recordings.runs import read_fixes, read_run
from fnn_ekf_ros.recordings.trajectories import read_trajectory
from fnn_ekf_ros.reports import plots
from fnn_ekf_ros.reports.findings import read_findings
from fnn_ekf_ros.reports.page import require_jinja2, write_page
from fnn_ekf_ros.reports.pictures import require_matplotlib
from fnn_ekf_ros.reports.results import check_result_folder, result_folder
from fnn_ekf_ros.reports.score_table import format_more, format_table
from fnn_ekf_ros.timeline.trajectory import Trajectory

TRACKS = ("odom", "truth")
"""What is exported of a run, as in the names of the files."""


class Evaluated(NamedTuple):
    """A run with what was found of it.

    Attributes:
        record: what the localizer published.
        truth: the ground truth; None if the recording has none.
        found: the evaluation.
    """

    record: RunRecord
    truth: Trajectory | None
    found: Evaluation


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("bags", metavar="BAG", type=Path, nargs="+", help="a recording of one run")
    topic: dict[str, Any] = {"metavar": "TOPIC", "type": messages.absolute_name}
    parser.add_argument(
        "--odom-topic", default="/odom", help="topic of the estimate (/odom)", **topic
    )
    parser.add_argument("--truth-topic", help="topic of the ground truth (/ground_truth)", **topic)
    parser.add_argument(
        "--truth-bag", metavar="BAG", type=Path, help="take the ground truth from this bag"
    )
    parser.add_argument(
        "--align", choices=[str(mode) for mode in Alignment], default=str(Alignment.NONE),
        help="move odom before it is compared: not at all (none), by the motion of the plane with "
        "the least squares (se2), or so that the first poses agree (origin)",
    )  # fmt: skip
    parser.add_argument(
        "--rpe", metavar="DELTA", default="1m",
        help="step of relative errors: a length such as 10m, or a number such as 1poses (1m)",
    )  # fmt: skip
    parser.add_argument(
        "--labels", nargs="+", metavar="LABEL", type=readable,
        help="names of the runs, one for each bag",
    )  # fmt: skip
    _add_results(parser)
    parser.add_argument(
        "--draw", nargs="+", metavar="LABEL", type=readable,
        help="draw only these runs; the table has all of them",
    )  # fmt: skip
    parser.add_argument(
        "--highlight", metavar="LABEL", type=readable,
        help="draw this run on top, with the uncertainty that it reports (the only run)",
    )  # fmt: skip
    parser.add_argument(
        "--fixes-topic",
        help="position fixes to draw, from the bag of the ground truth (/lrf_pose if it is there)",
        **topic,
    )


def _add_results(parser: argparse.ArgumentParser) -> None:
    """Declare the options that write something."""
    add_text_argument(parser, "--json", "write all numbers as JSON")
    parser.add_argument("--plot", metavar="PNG", type=Path, help="draw trajectories and errors")
    parser.add_argument(
        "--report", metavar="HTML", type=Path,
        help="write a page with numbers, verdicts and pictures, of one bag, with ground truth or "
        "without",
    )  # fmt: skip
    parser.add_argument(
        "--findings", metavar="JSON", type=Path, help="show what doctor --json wrote in the report"
    )
    parser.add_argument(
        "--tum", metavar="DIR", type=Path, help="write tracks and ground truth in the format of TUM"
    )
    parser.add_argument(
        "--kitti", metavar="DIR", type=Path,
        help="write them in the format of KITTI, at the times that both have",
    )  # fmt: skip
    add_force_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    check_bags([*arguments.bags, *_truth_bags(arguments)])
    labels = arguments.labels or [readable(str(path)) for path in arguments.bags]
    delta = parse_delta(arguments.rpe)
    _check(arguments, labels)
    findings = None if arguments.findings is None else read_findings(arguments.findings)
    alignment = Alignment(arguments.align)
    evaluated: dict[str, Evaluated] = {}
    truths: dict[Path, Trajectory | None] = {}
    for label, path in zip(labels, arguments.bags, strict=True):
        source = arguments.truth_bag or path
        if source not in truths:
            truths[source] = _read_truth(source, arguments)
        record = _read_run(path, source, arguments)
        found = evaluate(record, truths[source], alignment, delta)
        if truths[source] is not None and found.truth is None:
            raise BagError(
                f"bag '{path}': {arguments.odom_topic} and {_truth_topic(arguments)} have no time "
                "in common"
            )
        evaluated[label] = Evaluated(record, truths[source], found)
    drawn = _runs_to_draw(arguments, labels, evaluated) if arguments.plot is not None else {}
    _print(evaluated, _truth_topic(arguments))
    _write_numbers(arguments, evaluated)
    if arguments.plot is not None:
        highlight = arguments.highlight or (next(iter(drawn)) if len(drawn) == 1 else None)
        plots.plot_tracks(arguments.plot, drawn, highlight)
    if arguments.report is not None:
        ((label, only),) = evaluated.items()
        write_page(arguments.report, label, only.record, only.truth, only.found, findings)
        print(f"\nReport: {arguments.report}")
    return 0


def _read_run(path: Path, source: Path, arguments: argparse.Namespace) -> RunRecord:
    """Return the run in a bag, with the fixes of the bag of its ground truth."""
    same = source == path
    with BagReader(path) as bag:
        record = read_run(bag, arguments.odom_topic, arguments.fixes_topic if same else None)
    if same:
        return record
    with BagReader(source) as bag:
        return replace(record, fixes=read_fixes(bag, arguments.fixes_topic) or record.fixes)


def _truth_topic(arguments: argparse.Namespace) -> str:
    return arguments.truth_topic or messages.absolute_name(messages.GROUND_TRUTH)


def _read_truth(source: Path, arguments: argparse.Namespace) -> Trajectory | None:
    """Return the ground truth of a bag; None if there is none and it is not needed."""
    topic = _truth_topic(arguments)
    optional = arguments.report is not None and not (arguments.truth_bag or arguments.truth_topic)
    with BagReader(source) as bag:
        if optional and topic not in bag.topics:
            return None
        return read_trajectory(bag, topic)


def _print(evaluated: Mapping[str, Evaluated], truth_topic: str) -> None:
    """Print the tables, and below them what the numbers mean."""
    against = {
        label: each.found.truth for label, each in evaluated.items() if each.found.truth is not None
    }
    if against:
        print(format_table(against), format_more(against), sep="\n\n")
    for label, each in evaluated.items():
        print()
        if each.truth is None:
            print(
                f"{label}: no ground truth ({truth_topic}), so no errors: what needs none follows"
            )
        for line in sentences(each.found, by_sensor=len(evaluated) == 1):
            print(f"{label}: {line}")


def _write_numbers(arguments: argparse.Namespace, evaluated: Mapping[str, Evaluated]) -> None:
    """Write JSON and tracks as far as they were asked for."""
    if arguments.json is not None:
        content = {
            label: plain(each.found) | plain_run(each.record) for label, each in evaluated.items()
        }
        arguments.json.write_json(content, indent=2)
    for kind in ("tum", "kitti"):
        folder = getattr(arguments, kind)
        if folder is None:
            continue
        with result_folder(folder, f"--{kind}") as work:
            for label, each in evaluated.items():
                for name, text in _tracks(kind, each).items():
                    write_text(work / _track_file(label, name, kind), text)


def _tracks(kind: str, each: Evaluated) -> dict[str, str]:
    """Return the texts of a run's track and ground truth in a format."""
    if kind == "tum":
        texts = {"odom": tum_text(each.record.track)}
        return texts if each.truth is None else texts | {"truth": tum_text(each.truth)}
    if each.found.truth is None:
        return {"odom": kitti_text(each.record.track.pose)}
    matched = each.found.truth.matched
    back = each.record.track.pose[_places(each.record.track, matched.time_ns)]
    return {"odom": kitti_text(back), "truth": kitti_text(matched.truth)}


def _places(track: Trajectory, time_ns: Any) -> Any:
    """Return the indices of a track's poses at some of its times."""
    return track.time_ns.searchsorted(time_ns)


def _file_name(label: str) -> str:
    """Return a label as the begin of a file's name."""
    return re.sub(r"[^\w.-]+", "_", label).strip("._") or "run"


def _track_file(label: str, name: str, kind: str) -> str:
    """Return the name of the file of a track, `odom` or `truth`, in a format."""
    return f"{_file_name(label)}_{name}.{kind}"


def _truth_bags(arguments: argparse.Namespace) -> list[Path]:
    return [] if arguments.truth_bag is None else [arguments.truth_bag]


def _check(arguments: argparse.Namespace, labels: Sequence[str]) -> None:
    """Refuse labels and files that do not fit, and what cannot be drawn."""
    if len(labels) != len(arguments.bags):
        raise FnnEkfError(f"--labels: {len(labels)} labels, expected {len(arguments.bags)}")
    if len(set(labels)) < len(labels):
        raise FnnEkfError(f"{', '.join(labels)}: expected different labels, see --labels")
    if arguments.plot is not None and arguments.plot.suffix != ".png":
        raise FnnEkfError(f"--plot {arguments.plot}: expected a name that ends in .png")
    _check_report(arguments)
    _check_results(arguments, labels)
    drawn = arguments.draw or labels
    highlighted = [] if arguments.highlight is None else [arguments.highlight]
    for option, names, known in (("--draw", drawn, labels), ("--highlight", highlighted, drawn)):
        for name in names:
            if name not in known:
                raise FnnEkfError(f"{option} {name}: expected one of {', '.join(known)}")


def _check_results(arguments: argparse.Namespace, labels: Sequence[str]) -> None:
    """Refuse names of results that cannot be written."""
    inputs = [*arguments.bags, *_truth_bags(arguments)]
    inputs += [] if arguments.findings is None else [arguments.findings]
    check_command_results(arguments, ["--json", "--plot", "--report"], inputs)
    if (arguments.tum or arguments.kitti) and len({_file_name(label) for label in labels}) < len(
        labels
    ):
        raise FnnEkfError(f"{', '.join(labels)}: expected labels that make different file names")
    for kind in ("tum", "kitti"):
        if (folder := getattr(arguments, kind)) is not None:
            names = [_track_file(label, name, kind) for label in labels for name in TRACKS]
            check_result_folder(f"--{kind}", folder, replaces=arguments.force, names=names)
    if arguments.plot is not None or arguments.report is not None:
        require_matplotlib()


def _check_report(arguments: argparse.Namespace) -> None:
    """Refuse a report that cannot be made."""
    if arguments.report is None:
        if arguments.findings is not None:
            raise FnnEkfError(
                f"--findings {arguments.findings}: expected --report, which shows them"
            )
        return
    if arguments.report.suffix.lower() not in (".html", ".htm"):
        raise FnnEkfError(f"--report {arguments.report}: expected a name that ends in .html")
    if len(arguments.bags) > 1:
        raise FnnEkfError(
            f"--report: {len(arguments.bags)} bags, expected one; compare sets several side by side"
        )
    require_jinja2()


def _runs_to_draw(
    arguments: argparse.Namespace, labels: Sequence[str], evaluated: Mapping[str, Evaluated]
) -> dict[str, plots.Run]:
    """Return the runs that were asked for, as they are drawn."""
    drawn = list(dict.fromkeys(arguments.draw or labels))
    runs = {}
    for label in drawn:
        each = evaluated[label]
        if each.truth is None or each.found.truth is None:
            raise FnnEkfError(f"--plot: {label} has no ground truth; --report draws a run without")
        track = aligned_track(each.record.track, each.found.truth.motion)
        runs[label] = plots.Run(track, each.truth, plots.positions(each.record.fixes))
    return runs
