# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Runs the examples of the documents and writes what they show: python3 scripts/write_examples.py.

Numbers in README.md and docs/*.md that a command beside them gives are rewritten in place. The
line of the live run in the README's table is not: `make demo` prints it.
"""

import argparse
import contextlib
import io
import json
import re
import shlex
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import demo
from documents import COMMAND, INDENTED, ROOT, example, files, read

from fnn_ekf_ros.cli import run_command
from fnn_ekf_ros.commands.simulate import START_NS
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.messages import stamp_ns
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.timeline.events import Level

BAG, PARAMETERS = ROOT / demo.BAG, ROOT / demo.PARAMETERS
"""The demo's bag, and the parameters of its robot."""
DEMO_RUNS = {label: demo.REPLAYS[name] for label, name in demo.RUNS.items() if name in demo.REPLAYS}
"""Lines of the README's table, and the arguments of `replay` for each in scripts/demo.py."""
MEASURED = ("bias.yaml", "late.yaml", "health.json", "warehouse")
"""Words of the examples whose output is shown; `SHOWN` runs them."""
ADAPTED = "FNN-EKF, replay"
"""Line of the demo's table whose estimated noise is shown."""
SHOWN_VALUES = (
    "suspicion [nats]", "yaw offset [rad]", "yaw offset std [rad]", "parameter that would fit",
    "lasting errors",
)  # fmt: skip
"""Values that are shown with a report."""
NUMBERS = r"(?:[\d.]+ \| ){3}[\d.]+"
"""Pattern of the numbers in a line of the README's table."""
PRINTED = r"(?: {4}[^\n]*\n|\n)+?"
"""Pattern of an indented block in which lines may be empty."""
LATE = ("in time", "late", "stamped on arrival", "waited for")
"""Runs of the example with late fixes, in the order of the text."""


class Shown(NamedTuple):
    """Part of a document that shows the result of an example.

    Attributes:
        document: its name.
        name: of a few words.
        pattern: has one group, what is shown.
        value: returns what should be there, given a folder to run in; what several values need is
            made there once.
    """

    document: str
    name: str
    pattern: str
    value: Callable[[Path], str]


def run(arguments: Sequence[object], folder: Path) -> str:
    """Run one of the package's commands in a folder; return what it prints.

    Raises:
        RuntimeError: it failed.
    """
    words = [str(word) for word in arguments]
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        code = run_command(words[0], words[1:])
    if code or err.getvalue():
        raise RuntimeError(f"{shlex.join(words)}: exit code {code}: {err.getvalue()}")
    return out.getvalue()


def run_lines(lines: Sequence[str], folder: Path) -> str:
    """Run the lines of an example in a folder; return what the last one prints."""
    said = ""
    for line in lines:
        said = run(shlex.split(line.removeprefix(COMMAND)), folder)
    return said


def scores(printed: str) -> dict[str, list[float]]:
    """Return the numbers that `evaluate` prints: of each run x, y, theta, position, NEES."""
    table, _, _ = printed.partition("\n\n")
    rows = [line.rsplit(maxsplit=6) for line in table.splitlines()[2:]]
    return {label: [float(text) for text in numbers] for label, _, *numbers in rows}


def demo_bag(label: str, folder: Path) -> Path:
    """Return the bag of one of the demo's replays."""
    out = folder / label
    if not out.exists():
        run(["replay", BAG, out, "--params", PARAMETERS, *DEMO_RUNS[label]], folder)
    return out


def demo_row(label: str, folder: Path) -> str:
    """Return the numbers of a line of the README's table."""
    bag = demo_bag(label, folder)
    printed = run(["evaluate", bag, "--labels", "run", "--truth-bag", BAG], folder)
    x, y, theta, _, nees = scores(printed)["run"]
    return f"{x:.3f} | {y:.3f} | {theta:.3f} | {nees:.1f}"


def reports(bag: Path) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield the reports of /diagnostics: the robot's time [s], statuses by their short names."""
    with BagReader(bag) as reader:
        for record in reader.records({"/diagnostics"}):
            message = reader.message(record)
            statuses = {status.name.split(": ", 1)[-1]: status for status in message.status}
            yield (stamp_ns(message) - START_NS) * 1e-9, statuses


def values(status: Any) -> dict[str, str]:
    """Return the values of a status by key."""
    return {entry.key: entry.value for entry in status.values}


def estimated_noise(folder: Path) -> str:
    """Return values of `filter` at the end of the demo's replay, as in docs/diagnostics.md."""
    *_, (_, last) = reports(demo_bag(ADAPTED, folder))
    found = values(last["filter"])
    names = (
        "adaptation", "process noise", "measurement noise", "estimated noise", "reason:", "weights",
        "lasting errors",
    )  # fmt: skip
    return "".join(f"    {key}: {found[key]}\n" for key in found if f"{key}:".startswith(names))


def report(after_s: float, folder: Path) -> str:
    """Return the first report so long after the example's fault, as docs/diagnostics.md has it."""
    document, own = "docs/diagnostics.md", folder / "compass"
    faults = files(document)["bias.yaml"]
    if not own.exists():
        own.mkdir()
        (own / "bias.yaml").write_text(faults)
        run_lines(example(document, "bias.yaml").lines, own)
    (start,) = re.findall(r"start: ([\d.]+)", faults)
    bag = own / "out"
    statuses = next(found for time_s, found in reports(bag) if time_s >= float(start) + after_s)
    lines = []
    for name, status in statuses.items():
        level = Level(int(status.level)).name
        lines.append(f"    {name + ':':<9} {level:<5} {status.message}\n")
        shown = {key: value for key, value in values(status).items() if key in SHOWN_VALUES}
        lines += [f"      {key}: {value}\n" for key, value in shown.items()]
    return "".join(lines)


def health(folder: Path) -> str:
    """Return what the replay of docs/operation.md ends with, as it is there."""
    own = folder / "health"
    own.mkdir()
    _, *lines = run_lines(example("docs/operation.md", "health.json").lines, own).splitlines()
    return "".join(f"    {line}\n" for line in lines)


def late_fixes(folder: Path) -> str:
    """Return the position errors of the example of docs/results.md, in the order of its table."""
    document = "docs/results.md"
    block, timeline = example(document, "late.yaml"), files(document)["late.yaml"]
    late, on_arrival = timeline.splitlines()
    found = []
    for name, faults in zip(LATE, ("", late, f"{late}\n{on_arrival}", late), strict=True):
        own = folder / name
        own.mkdir()
        (own / "late.yaml").write_text(faults)
        lines = list(block.lines)  # simulate, replay, evaluate
        if not faults:
            lines[0] = lines[0].replace(" -p faults_file:=late.yaml", "")
        if name == LATE[-1]:  # the same recording as of those that nobody waits for
            shutil.copytree(folder / LATE[1] / "run", own / "run")
            shutil.copy(folder / LATE[1] / "run.yaml", own)
            lines = [f"{lines[1]} -p output_delay:=0.2", lines[2]]
        ((_, _, _, position, _),) = scores(run_lines(lines, own)).values()
        found.append(f"{position:.4f}")
    return f"{', '.join(found[:-1])} and {found[-1]}"


def printed_lines(printed: str) -> str:
    """Return what a command prints as an indented block."""
    lines = printed.rstrip("\n").splitlines()
    return "".join(f"    {line}\n" if line else "\n" for line in lines)


def evaluated(folder: Path) -> str:
    """Return what `evaluate` prints of the demo's EKF."""
    return printed_lines(run(["evaluate", demo_bag("EKF", folder), "--labels", "EKF"], folder))


def compared(folder: Path) -> str:
    """Return what `compare` prints of the demo's EKF and FNN-EKF."""
    bags = demo_bag("EKF", folder), demo_bag(ADAPTED, folder)
    return printed_lines(run(["compare", *bags, "--labels", "EKF", "FNN-EKF"], folder))


def first_drive(command: str, folder: Path) -> str:
    """Return what a command of README's first drive prints, as far as README shows it."""
    printed = first_drive_of(folder)[command]
    if command == "doctor":  # after the table of topics
        _, _, printed = printed.partition("/right_ticks")
        printed = printed.partition("\n")[2].strip()
    elif command == "replay":  # without the time that it took
        printed = printed.partition("\n")[2]
    elif command == "evaluate":
        printed = "\n".join(line for line in printed.splitlines() if ": NEES: " in line)
    return printed_lines(printed)


def first_drive_of(folder: Path) -> dict[str, str]:
    """Run the commands of README's first drive, once for a folder; return what each prints."""
    own = folder / "first drive"
    said = own / "said.json"
    if not said.exists():
        own.mkdir()
        (own / "bags").symlink_to(ROOT / "bags")
        printed = {}
        for line in example("README.md", "warehouse").lines:
            words = shlex.split(line.removeprefix(COMMAND))
            printed[words[0]] = run(words, own)
        write_text(said, json.dumps(printed))
    return dict(json.loads(said.read_text()))


SHOWN = (
    *(
        Shown("README.md", label, rf"^\| {label} \| ({NUMBERS}) \|$", partial(demo_row, label))
        for label in DEMO_RUNS
    ),
    *(
        Shown("README.md", command, rf"^`{command}` [^:]*:\n\n({PRINTED})\n[`#]",
              partial(first_drive, command))
        for command in ("doctor", "tune", "replay", "evaluate")
    ),
    Shown("docs/diagnostics.md", "after two seconds",
          rf"Two seconds into the fault:\n\n({INDENTED})", partial(report, 2.0)),
    Shown("docs/diagnostics.md", "after fifteen seconds",
          rf"Fifteen seconds into the fault:\n\n({INDENTED})", partial(report, 15.0)),
    Shown("docs/diagnostics.md", "end of the demo",
          rf"end of the demo:\n\n({INDENTED})", estimated_noise),
    Shown("docs/operation.md", "health of a replay",
          rf"so this ends with:\n\n({INDENTED})", health),
    Shown("docs/evaluate.md", "evaluate",
          rf"starts with wrong noise:\n\n({PRINTED})\n- ", evaluated),
    Shown("docs/evaluate.md", "compare", rf"--labels EKF FNN-EKF`\):\n\n({PRINTED})\n- ", compared),
    Shown("docs/results.md", "late fixes", r"these give\s+(.*?)\.\n", late_fixes),
)  # fmt: skip
"""All parts of documents that are rewritten."""


def shown_in(text: str, shown: Shown) -> re.Match[str]:
    """Return the one place of a document's text that shows something of an example.

    Raises:
        ValueError: it is not there, or more than once.
    """
    found = list(re.finditer(shown.pattern, text, flags=re.MULTILINE))
    if len(found) != 1:
        raise ValueError(f"{shown.document}: '{shown.name}' is there {len(found)} times")
    return found[0]


def main(argv: Sequence[str] | None = None) -> None:
    """Rewrite what the documents show."""
    argparse.ArgumentParser(description=__doc__).parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        for shown in SHOWN:
            value = shown.value(Path(folder))
            text = read(shown.document)
            begin, end = shown_in(text, shown).span(1)
            write_text(ROOT / shown.document, text[:begin] + value + text[end:])
            same = "as before" if text[begin:end] == value else "changed"
            print(f"{shown.document}, {shown.name}: {same}", flush=True)


if __name__ == "__main__":
    main()
