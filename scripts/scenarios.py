# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Scenarios of other localizers: their tests and issues, through this localizer.

Runs each with several seeds in simulated time and rewrites their section of docs/faults.md.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from command_line import exit_code
from documents import ROOT, SCENARIOS, read, with_section
from faults.recordings import code_version
from foreign.cases import EQUALITIES, RECOVERIES
from foreign.runs import Measured
from foreign.tables import section

import fnn_ekf_ros
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.stopping import exit_by_signal

DOCUMENT = "docs/faults.md"
"""The document with the section."""
CODE = ("fnn_ekf_ros", "scripts/scenarios.py", "scripts/foreign")
"""Files that decide how a run goes."""
SEEDS = (1, 2, 3, 4, 5)
"""Seeds of the runs of each scenario."""


def made() -> None:
    """Run all scenarios and write the section.

    Raises:
        FnnEkfError: it cannot be done.
        OSError: the document cannot be read or written.
    """
    package = Path(fnn_ekf_ros.__file__).resolve().parent
    if package != ROOT / "fnn_ekf_ros":
        raise FnnEkfError(f"Python finds the package in {package}, not in this clone")
    made_by = code_version(ROOT, CODE)
    every = (*RECOVERIES, *EQUALITIES)
    results: dict[str, list[Measured]] = {}
    for number, scenario in enumerate(every, start=1):
        results[scenario.name] = [scenario.measure(seed) for seed in SEEDS]
        print(f"{number:2d} of {len(every)}: {scenario.name}", flush=True)
    text = section(RECOVERIES, EQUALITIES, results, SEEDS, made_by)
    write_text(ROOT / DOCUMENT, with_section(read(DOCUMENT), SCENARIOS, text))
    print(f"{DOCUMENT}: {len(every)} scenarios, {made_by}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the scenarios; return the exit code."""
    argparse.ArgumentParser(description=__doc__).parse_args(argv)
    exit_by_signal()
    return exit_code("scenarios", made, f"{DOCUMENT} stays as it was")


if __name__ == "__main__":
    sys.exit(main())
