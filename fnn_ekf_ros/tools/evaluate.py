"""`evaluate BAG...`: errors of recorded odom against a recorded ground truth."""

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.bag_files import BagError, BagReader
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.limits import LARGEST_POSITION
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.text_files import write_text
from fnn_ekf_ros.tools import plots
from fnn_ekf_ros.tools.arguments import readable
from fnn_ekf_ros.tools.pictures import require_matplotlib
from fnn_ekf_ros.tools.result_folder import check_result_file
from fnn_ekf_ros.tools.scoring import Score, Track, score

_ROW = "{:<28} {:>7} {:>9} {:>9} {:>11} {:>13} {:>9}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("bags", metavar="BAG", type=Path, nargs="+", help="one run each")
    topic: dict[str, Any] = {"metavar": "TOPIC", "type": messages.absolute_name}
    parser.add_argument("--odom-topic", default="/odom", help="(/odom)", **topic)
    parser.add_argument("--truth-topic", default="/ground_truth", help="(/ground_truth)", **topic)
    parser.add_argument(
        "--truth-bag", metavar="BAG", type=Path, help="take the ground truth from this bag"
    )
    parser.add_argument(
        "--labels", nargs="+", metavar="LABEL", type=readable,
        help="names of the runs, one for each bag",
    )  # fmt: skip
    parser.add_argument("--json", metavar="FILE", type=Path, help="write the numbers as JSON")
    parser.add_argument("--plot", metavar="PNG", type=Path, help="draw tracks and errors")
    parser.add_argument(
        "--draw", nargs="+", metavar="LABEL", type=readable,
        help="draw these runs only; the table has all",
    )  # fmt: skip
    parser.add_argument(
        "--highlight", metavar="LABEL", type=readable,
        help="draw this run above the others, with the uncertainty it claims (a single run)",
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
    runs: dict[str, tuple[Track, Track]] = {}
    truths: dict[Path, Track] = {}
    for label, path in zip(labels, arguments.bags, strict=True):
        source = arguments.truth_bag or path
        if source not in truths:
            with BagReader(source) as bag:
                truths[source] = read_track(bag, arguments.truth_topic)
        with BagReader(path) as bag:
            estimate = read_track(bag, arguments.odom_topic)
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
        write_text(arguments.json, json.dumps(_plain(scores), indent=2, allow_nan=False) + "\n")
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
    runs: Mapping[str, tuple[Track, Track]],
) -> dict[str, plots.Run]:
    """Return the runs that were asked for, with the fixes in the bags of their ground truth."""
    drawn = list(dict.fromkeys(arguments.draw or runs))
    fixes: dict[Path, FloatArray] = {}
    for source in {sources[label]: None for label in drawn}:
        with BagReader(source) as bag:
            fixes[source] = _read_fixes(bag, arguments.fixes_topic)
    return {label: plots.Run(*runs[label], fixes[sources[label]]) for label in drawn}


def _read_fixes(bag: BagReader, asked: str | None) -> FloatArray:
    """Return the positions `(n, 2)` [m] of a topic of pose fixes.

    Raises:
        BagError: the topic that was asked for is missing or of another type.
    """
    topic = asked or messages.absolute_name(messages.LRF_POSE)
    if asked is not None:
        _check_topic(bag, topic, messages.POSE_TYPE)
    elif topic not in bag.topics or bag.topics[topic].type_name != messages.POSE_TYPE:
        return np.zeros((0, 2))
    fixes = [messages.planar_pose(bag.message(record))[:2] for record in bag.records({topic})]
    return np.array(fixes).reshape(-1, 2)


def read_track(bag: BagReader, topic: str) -> Track:
    """Return the poses of a nav_msgs/Odometry topic in the order of their stamps.

    Raises:
        BagError: no such topic, another type, or no message.
    """
    _check_topic(bag, topic, messages.ODOMETRY_TYPE)
    stamps, poses, covariances = [], [], []
    for record in bag.records({topic}):
        message = bag.message(record)
        stamps.append(messages.stamp_ns(message))
        pose = messages.planar_pose(message)
        if not np.all(np.abs(pose[:2]) <= LARGEST_POSITION):
            raise BagError(
                f"bag '{bag.path}': {topic} at {stamps[-1]} ns is at ({pose[0]:g}, {pose[1]:g}) m, "
                "expected finite coordinates"
            )
        poses.append(pose)
        covariances.append(messages.planar_block(message.pose.covariance))
    if not stamps:
        raise BagError(f"bag '{bag.path}': topic {topic} is empty")
    time_ns, first = np.unique(np.array(stamps), return_index=True)
    return Track(time_ns, np.array(poses)[first], np.array(covariances)[first])


def _check_topic(bag: BagReader, topic: str, type_name: str) -> None:
    found = bag.topics.get(topic)
    if found is None or found.type_name != type_name:
        kind = "missing" if found is None else f"of type {found.type_name}"
        raise BagError(
            f"bag '{bag.path}': topic {topic} is {kind}, expected {type_name}; "
            f"it has {', '.join(sorted(bag.topics)) or 'no topics'}"
        )


def format_table(scores: Mapping[str, Score]) -> str:
    """Return the scores as a table, one line for each run."""
    lines = [
        _ROW.format("run", "odoms", "RMSE x", "RMSE y", "RMSE theta", "RMSE position", "mean NEES"),
        _ROW.format("", "", "[m]", "[m]", "[rad]", "[m]", "(3)"),
    ]
    lines += [
        _ROW.format(label, s.count, *_texts(s.rmse_x, s.rmse_y, s.rmse_theta, s.rmse_position),
                    "n/a" if math.isnan(s.mean_nees) else f"{s.mean_nees:.2f}")
        for label, s in scores.items()
    ]  # fmt: skip
    return "\n".join(lines)


def _texts(*values: float) -> Sequence[str]:
    return ["n/a" if math.isnan(value) else f"{value:.4f}" for value in values]


def _plain(scores: Mapping[str, Score]) -> dict[str, dict[str, float | None]]:
    """Return the scores as JSON can hold them; null where a number is not known."""
    return {
        label: {
            key: None if isinstance(value, float) and math.isnan(value) else value
            for key, value in asdict(s).items()
        }
        for label, s in scores.items()
    }
