# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`evaluate BAG...`: errors of recorded odom against a recorded ground truth."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fnn_ekf_ros import messages
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import readable, write_json
from fnn_ekf_ros.recordings.bag_files import BagError, BagReader
from fnn_ekf_ros.recordings.scoring import Score, Trajectory, score
from fnn_ekf_ros.recordings.trajectories import read_fixes, read_trajectory
from fnn_ekf_ros.reports import plots
from fnn_ekf_ros.reports.pictures import require_matplotlib
from fnn_ekf_ros.reports.result_folder import check_result_file
from fnn_ekf_ros.reports.score_table import format_table, plain_scores


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("bags", metavar="BAG", type=Path, nargs="+", help="a recording of one run")
    topic: dict[str, Any] = {"metavar": "TOPIC", "type": messages.absolute_name}
    parser.add_argument(
        "--odom-topic", default="/odom", help="topic of the estimate (/odom)", **topic
    )
    parser.add_argument(
        "--truth-topic",
        default="/ground_truth",
        help="topic of the ground truth (/ground_truth)",
        **topic,
    )
    parser.add_argument(
        "--truth-bag", metavar="BAG", type=Path, help="take the ground truth from this bag"
    )
    parser.add_argument(
        "--labels", nargs="+", metavar="LABEL", type=readable,
        help="names of the runs, one for each bag",
    )  # fmt: skip
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the numbers as JSON")
    parser.add_argument("--plot", metavar="PNG", type=Path, help="draw trajectories and errors")
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


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    labels = arguments.labels or [readable(str(path)) for path in arguments.bags]
    _check(arguments, labels)
    scores: dict[str, Score] = {}
    runs: dict[str, tuple[Trajectory, Trajectory]] = {}
    truths: dict[Path, Trajectory] = {}
    for label, path in zip(labels, arguments.bags, strict=True):
        source = arguments.truth_bag or path
        if source not in truths:
            with BagReader(source) as bag:
                truths[source] = read_trajectory(bag, arguments.truth_topic)
        with BagReader(path) as bag:
            estimate = read_trajectory(bag, arguments.odom_topic)
        result = score(estimate, truths[source])
        if result is None:
            raise BagError(
                f"bag '{path}': {arguments.odom_topic} and {arguments.truth_topic} have no time "
                "in common"
            )
        scores[label], runs[label] = result, (estimate, truths[source])
    if arguments.plot is not None:
        sources = {label: arguments.truth_bag or path
                   for label, path in zip(labels, arguments.bags, strict=True)}  # fmt: skip
        chosen = _runs_to_draw(arguments, sources, runs)
    print(format_table(scores))
    if arguments.json is not None:
        write_json(arguments.json, plain_scores(scores), indent=2)
    if arguments.plot is not None:
        highlight = arguments.highlight or (next(iter(chosen)) if len(chosen) == 1 else None)
        plots.plot_tracks(arguments.plot, chosen, highlight)
    return 0


def _check(arguments: argparse.Namespace, labels: Sequence[str]) -> None:
    """Refuse labels and files that do not fit, and a picture that cannot be drawn."""
    if len(labels) != len(arguments.bags):
        raise FnnEkfError(f"--labels: {len(labels)} labels, expected {len(arguments.bags)}")
    if len(set(labels)) < len(labels):
        raise FnnEkfError(f"{', '.join(labels)}: expected different labels, see --labels")
    if arguments.plot is not None and arguments.plot.suffix != ".png":
        raise FnnEkfError(f"--plot {arguments.plot}: expected a name that ends in .png")
    taken = [*arguments.bags, *([] if arguments.truth_bag is None else [arguments.truth_bag])]
    for option, path in (("--json", arguments.json), ("--plot", arguments.plot)):
        if path is not None:
            check_result_file(option, path, taken)
            taken.append(path)
    if arguments.plot is not None:
        require_matplotlib()
    drawn = arguments.draw or labels
    highlighted = [] if arguments.highlight is None else [arguments.highlight]
    for option, names, known in (("--draw", drawn, labels), ("--highlight", highlighted, drawn)):
        for name in names:
            if name not in known:
                raise FnnEkfError(f"{option} {name}: expected one of {', '.join(known)}")


def _runs_to_draw(
    arguments: argparse.Namespace,
    sources: Mapping[str, Path],
    runs: Mapping[str, tuple[Trajectory, Trajectory]],
) -> dict[str, plots.Run]:
    """Return the runs that were asked for, with the fixes in the bags of their ground truth."""
    drawn = list(dict.fromkeys(arguments.draw or runs))
    fixes: dict[Path, FloatArray] = {}
    for source in {sources[label]: None for label in drawn}:
        with BagReader(source) as bag:
            fixes[source] = read_fixes(bag, arguments.fixes_topic)
    return {label: plots.Run(*runs[label], fixes[sources[label]]) for label in drawn}
