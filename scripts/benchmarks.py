# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The benchmark: what a filter step, a batch, `replay`, the live node and a study cost.

Writes docs/benchmarks.md and docs/benchmarks.json once all rows are measured. With --only or
--quick, or if a row fails, the same files go to build/bench instead, and those in docs stay as they
are.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from bench import batch_rows, machine, node_row, replay_row, step_row, study_row
from bench.document import as_json, document, table
from bench.places import packages_folder
from bench.results import Context, Result, missed
from command_line import exit_code

import fnn_ekf_ros
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.stopping import exit_by_signal

ROOT = Path(__file__).resolve().parents[1]
"""Folder of the clone."""
DOCS, BUILD = ROOT / "docs", ROOT / "build" / "bench"
"""Folders for complete results and for those of a part."""
NAME = "benchmarks"
"""Name of the result files, without their endings."""
AGAINST = "555235c"
"""The last commit before the core was rewritten."""
ROWS = {
    row.name: row
    for row in (
        step_row.ROW,
        batch_rows.ROW,
        batch_rows.MEMORY_ROW,
        replay_row.ROW,
        node_row.ROW,
        study_row.ROW,
    )
}
"""The rows by name, in the document's order."""


def parsed(argv: Sequence[str] | None) -> argparse.Namespace:
    """Return the command line, checked."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", nargs="+", metavar="ROW", choices=ROWS, help=f"some of {', '.join(ROWS)} (all)"
    )
    against = f"commit that the batches are compared with ({AGAINST})"
    parser.add_argument("--against", metavar="COMMIT", default=AGAINST, help=against)
    quick = "fewer and shorter rounds, in some minutes: to see whether it runs"
    parser.add_argument("--quick", action="store_true", help=quick)
    return parser.parse_args(argv)


def measured(context: Context, names: Sequence[str]) -> tuple[dict[str, Result], list[str]]:
    """Measure rows; show each when it is done. Return their results and the rows that failed."""
    results, failed = {}, []
    for name in names:
        began = time.monotonic()
        try:
            result = ROWS[name].measure(context)
        except FnnEkfError as error:
            failed.append(name)
            result = Result(skipped=f"it failed ({error})")
        results[name] = result
        said = f"not measured: {result.skipped}" if result.skipped else table(result.lines)
        print(f"\n{ROWS[name].title} ({time.monotonic() - began:.0f} s)\n\n{said}", flush=True)
    return results, failed


def made(arguments: argparse.Namespace) -> None:
    """Measure what is asked for, and write it.

    Raises:
        FnnEkfError: a row failed, or the code was changed.
        OSError: a file cannot be written.
    """
    package = Path(fnn_ekf_ros.__file__).resolve().parent
    if package != ROOT / "fnn_ekf_ros":
        raise FnnEkfError(f"Python finds the package in {package}, not in this clone")
    BUILD.mkdir(parents=True, exist_ok=True)
    names = [name for name in ROWS if not arguments.only or name in arguments.only]
    part = arguments.quick or len(names) < len(ROWS)
    began_s, load = time.monotonic(), machine.load()
    commit, code = machine.commit(ROOT), machine.code(ROOT)

    def say(text: str) -> None:
        print(f"{time.monotonic() - began_s:5.0f} s: {text}", file=sys.stderr, flush=True)

    context = Context(
        root=ROOT, build=BUILD, against=arguments.against, quick=arguments.quick, say=say
    )
    results, failed = measured(context, names)
    if machine.code(ROOT) != code:
        raise FnnEkfError("the code was changed while it was measured")
    facts = machine.facts(commit, packages_folder(BUILD), arguments.against, load)
    folder = BUILD if part or failed else DOCS
    write_text(folder / f"{NAME}.md", document(facts, [ROWS[name] for name in names], results))
    write_text(folder / f"{NAME}.json", as_json(facts, results))
    fails = missed(results)
    print(
        f"{folder / NAME}.md, .json: {len(names)} rows of commit {commit}, {len(fails)} bars missed"
    )
    if failed:
        raise FnnEkfError(f"rows that failed: {', '.join(failed)}; docs/{NAME}.md stays as it was")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmark, or some rows of it; return the exit code, 0 if bars are missed too."""
    arguments = parsed(argv)
    exit_by_signal()
    return exit_code("benchmarks", lambda: made(arguments), "nothing is written")


if __name__ == "__main__":
    sys.exit(main())
