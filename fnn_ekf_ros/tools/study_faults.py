"""`study faults`: is the sensor that fails named, and is nobody named while nothing is wrong."""

import argparse
import json
import math
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import NODE_NAME as LOCALIZER
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.study.fault_naming import (
    FAULTS,
    NAMED_WITHIN_S,
    PATHS,
    QUIET_PATHS,
    FaultCase,
    Naming,
    Quiet,
    Setting,
    name_fault,
    quiet_run,
    told_noise,
)
from fnn_ekf_ros.study.starts import CORNERS, RIGHT, Cell
from fnn_ekf_ros.text_files import write_text
from fnn_ekf_ros.tools.arguments import add_parameter_arguments, given_parameters
from fnn_ekf_ros.tools.progress import with_progress
from fnn_ekf_ros.tools.result_folder import prepare_study
from fnn_ekf_ros.tools.simulate import matching_localizer
from fnn_ekf_ros.tools.study_tables import plain, start_words, table
from fnn_ekf_ros.tools.workers import add_jobs_argument, given_jobs, in_any_order
from fnn_ekf_ros.version import version

NAME = "faults"
SUMMARY = "faults of one sensor at a time: whom diagnostics name, and how soon"
LIMITS = {"runs": (1, 1000), "quiet_runs": (0, 1000), "seed": (0, 2**31 - 1)}
LONGEST_S = 3600.0
HOW_TO_READ = f"""\
A fault begins 40 to 60 s after the start; runs take turns on the paths {", ".join(PATHS)}. Named:
within {NAMED_WITHIN_S:g} s the sensor's own status was WARN or worse, as it is where `filter` names
it. First: no other sensor's was before it. Alone: no other sensor's was at all in that time.
Quiet runs have no fault: the share of reports, from when the filter runs, in which any status is
WARN or worse; starts as in the other studies.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True,
        help="folder for tables and numbers; files of the same name are replaced",
    )  # fmt: skip
    parser.add_argument("--runs", metavar="N", type=int, default=20, help="of each fault (20)")
    parser.add_argument(
        "--quiet-runs", metavar="N", type=int, default=10,
        help="without a fault, of each path and start (10)",
    )  # fmt: skip
    parser.add_argument(
        "--quiet-seconds", metavar="S", type=float, default=300.0, help="their length (300)"
    )
    parser.add_argument("--seed", metavar="S", type=int, default=1, help="of everything (1)")
    parser.add_argument(
        "--faults", metavar="A,B", help=f"some of {', '.join(case.name for case in FAULTS)} (all)"
    )
    add_jobs_argument(parser)
    add_parameter_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    for name, (least, most) in LIMITS.items():
        value = getattr(arguments, name)
        if not least <= value <= most:
            option = name.replace("_", "-")
            raise FnnEkfError(f"--{option} {value}: expected {least} to {most}")
    if not 1.0 <= arguments.quiet_seconds <= LONGEST_S:
        raise FnnEkfError(
            f"--quiet-seconds {arguments.quiet_seconds:g}: expected 1 to {LONGEST_S:g}"
        )
    jobs = given_jobs(arguments)
    cases = _chosen(arguments.faults)
    given = given_parameters(arguments, LOCALIZER)
    _setting(PATHS[0], 0, RIGHT, given)  # wrong parameters are refused before anything is made
    out = arguments.out
    numbers = prepare_study(out, ["results.md"])
    made_by = {
        "study": NAME, "version": version(), "runs": arguments.runs,
        "quiet_runs": arguments.quiet_runs, "quiet_seconds": arguments.quiet_seconds,
        "seed": arguments.seed, "faults": [case.name for case in cases], "parameters": given,
    }  # fmt: skip

    fault_runs = [
        _FaultRun(case.name, number) for case in cases for number in range(arguments.runs)
    ]
    quiet_runs = [
        _QuietRun(cell, path, number)
        for cell in (RIGHT, *CORNERS)
        for path in QUIET_PATHS
        for number in range(arguments.quiet_runs)
    ]
    runs: list[_FaultRun | _QuietRun] = [*quiet_runs, *fault_runs]
    requests = [(each.words(), each) for each in runs]
    work = in_any_order(jobs, _Runner, requests, arguments.seed, arguments.quiet_seconds, given)
    with closing(work):
        done = dict(with_progress(work, len(requests), "study faults"))
    answers = [done[number] for number in range(len(requests))]
    quiet = [
        (each.cell, said) for each, said in zip(quiet_runs, answers[: len(quiet_runs)], strict=True)
    ]
    by_name = {case.name: case for case in cases}
    named = [
        Naming(by_name[each.case], *said)
        for each, said in zip(fault_runs, answers[len(quiet_runs) :], strict=True)
    ]

    content = {
        **made_by,
        "results": [_naming_row(naming) for naming in named],
        "quiet": [
            {"q": cell.q, "k": cell.k, **each._asdict(), "words": dict(each.words)}
            for cell, each in quiet
        ],
    }
    write_text(numbers, json.dumps(content, indent=1, allow_nan=False) + "\n")
    write_text(out / "results.md", _head(made_by) + fault_tables(cases, named, quiet))
    print(f"{out}: {_shares(named)}")
    print(f"{out / 'results.md'}: the tables")
    return 0


def fault_tables(
    cases: Sequence[FaultCase], named: Sequence[Naming], quiet: Sequence[tuple[Cell, Quiet]]
) -> str:
    """Return the results in Markdown."""
    lines = []
    for case in cases:
        own = [naming for naming in named if naming.case is case]
        after = np.array([n.named_s for n in own if math.isfinite(n.named_s)])
        others = Counter(other for naming in own for other in naming.others)
        lines.append(
            [
                case.name,
                case.about,
                case.sensor,
                f"{sum(n.named for n in own)} of {len(own)}",
                str(sum(n.named_first for n in own)),
                str(sum(n.right for n in own)),
                f"{np.median(after):.1f}, {np.max(after):.1f}" if len(after) else "n/a",
                ", ".join(f"{other} {count}" for other, count in others.most_common()) or "-",
            ]
        )
    parts = [
        "\n## Faults\n",
        table(
            ["fault", "what it is", "sensor", "named", "first", "alone",
             "after [s]: median, longest", "others that were named"],
            lines,
        ),
        f"All: {_shares(named)}.\n",
    ]  # fmt: skip
    if quiet:
        parts += ["## Quiet runs\n", _quiet_table(quiet)]
    return "\n".join(parts)


def _shares(named: Sequence[Naming]) -> str:
    """Return how many faults were named, by each of the three measures."""
    count = len(named)
    said = (
        f"{words} {right} ({right / count:.1%})"
        for words, right in (
            ("named in time", sum(naming.named for naming in named)),
            ("before any other sensor", sum(naming.named_first for naming in named)),
            ("and no other at all", sum(naming.right for naming in named)),
        )
    )
    return f"of {count} faults {', '.join(said)}"


def _quiet_table(quiet: Sequence[tuple[Cell, Quiet]]) -> str:
    lines = []
    for cell in dict.fromkeys(cell for cell, _ in quiet):
        for path in QUIET_PATHS:
            own = [each for each_cell, each in quiet if each_cell == cell and each.path == path]
            reports, warned = sum(e.reports for e in own), sum(e.warned for e in own)
            words: Counter[str] = Counter()
            for each in own:
                for said, count in each.words.items():
                    words[re.sub(r"[-\d.]*\d", "#", said)] += count
            most = "; ".join(f"{said} ({count})" for said, count in words.most_common(3))
            share = f"{warned / reports:.2%}" if reports else "n/a"
            lines.append([start_words(cell), path, str(reports), share, most or "-"])
    return table(["start", "path", "reports", "WARN or worse", "said most often"], lines)


class _FaultRun(NamedTuple):
    """A run with a fault.

    Attributes:
        case: name of the fault.
        number: of the run, from 0.
    """

    case: str
    number: int

    def words(self) -> str:
        """Return what it is."""
        return f"fault {self.case}, run {self.number + 1}"


class _QuietRun(NamedTuple):
    """A run without a fault.

    Attributes:
        cell: how wrong the start is.
        path: what is driven.
        number: of the run, from 0.
    """

    cell: Cell
    path: str
    number: int

    def words(self) -> str:
        """Return what it is."""
        return f"quiet run {self.number + 1} on {self.path}, {start_words(self.cell)}"


class _Runner:
    """Runs robots with and without faults, in any process."""

    def __init__(self, seed: int, quiet_seconds: float, given: dict[str, Any]) -> None:
        self._seed = seed
        self._quiet_seconds = quiet_seconds
        self._given = given

    def __call__(self, run: _FaultRun | _QuietRun) -> Quiet | tuple[Any, ...]:
        """Return a `Quiet`, or a `Naming` without its case, which cannot be pickled."""
        if isinstance(run, _QuietRun):
            rng = np.random.default_rng([self._seed, run.number, 1])
            setting = _setting(run.path, int(rng.integers(2**31)), run.cell, self._given)
            return quiet_run(setting, self._quiet_seconds)
        (case,) = (case for case in FAULTS if case.name == run.case)
        # The same robots and onsets for every fault, whichever are chosen.
        rng = np.random.default_rng([self._seed, run.number])
        path = PATHS[run.number % len(PATHS)]
        setting = _setting(path, int(rng.integers(2**31)), RIGHT, self._given)
        return name_fault(case, setting, rng)[1:]


def _setting(path: str, seed: int, cell: Cell, given: dict[str, Any]) -> Setting:
    robot = FakeRobotParameters(path=path, seed=seed)
    matching = told_noise(matching_localizer(robot), cell)
    localizer = build(LocalizerParameters, asdict(matching) | given)
    return Setting(robot, localizer, networks_for(localizer))


def _chosen(words: str | None) -> list[FaultCase]:
    known = {case.name: case for case in FAULTS}
    if words is None:
        return list(FAULTS)
    chosen = [word.strip() for word in words.split(",")]
    for word in chosen:
        if word not in known:
            raise FnnEkfError(f"--faults {word}: expected some of {', '.join(known)}")
    return [case for name, case in known.items() if name in chosen]


def _naming_row(naming: Naming) -> dict[str, Any]:
    return {
        "fault": naming.case.name,
        "sensor": naming.case.sensor,
        "path": naming.path,
        "onset_s": naming.onset_s,
        "named_s": plain(naming.named_s),
        "named": naming.named,
        "first": naming.named_first,
        "alone": naming.right,
        "others": naming.others,
    }


def _head(made_by: dict[str, Any]) -> str:
    given = "".join(f" -p {name}:={value}" for name, value in made_by["parameters"].items())
    faults = ""
    if len(made_by["faults"]) < len(FAULTS):
        faults = f" --faults {','.join(made_by['faults'])}"
    return (
        f"# study {NAME}\n\nfnn_ekf_ros {made_by['version']}: `study {NAME} --runs "
        f"{made_by['runs']} --quiet-runs {made_by['quiet_runs']} --quiet-seconds "
        f"{made_by['quiet_seconds']:g} --seed {made_by['seed']}{faults}{given}`\n\n{HOW_TO_READ}"
    )
