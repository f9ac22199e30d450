# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The benchmark's document and its JSON file."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from bench.results import Line, Result, Row, missed

HEAD = """# Benchmarks

`make bench` writes this file and `benchmarks.json` beside it, which has the value of every round.
The measured variants of a row take turns: one round of each, then the next round. A line shows the
median of the rounds, the least and the most. A ratio is taken within each round. "CPU" is user plus
system time of all threads of a process, so that other work on the machine disturbs it less than
it disturbs elapsed time; it still does, through caches and clock rates: compare the load averages.
"""
"""Beginning of the document."""


def document(facts: Mapping[str, Any], rows: Sequence[Row], results: Mapping[str, Result]) -> str:
    """Return the document in Markdown.

    Args:
        facts: machine, commit and versions; see `machine.facts`.
        rows: the rows that were measured, in order.
        results: of each row, by its name.
    """
    parts = [HEAD, _facts(facts), _summary(results)]
    parts += [
        f"## {row.title}\n\n{row.how.strip()}\n\n{_result(results[row.name])}" for row in rows
    ]
    return "\n".join(parts)


def table(lines: Sequence[Line]) -> str:
    """Return the table of some lines."""
    head = "| | median | least | most | bar | |\n| --- | --- | --- | --- | --- | --- |\n"
    return head + "".join(_line(line) for line in lines)


def as_json(facts: Mapping[str, Any], results: Mapping[str, Result]) -> str:
    """Return the content of the JSON file."""
    content = {**facts, "rows": {name: result.as_json() for name, result in results.items()}}
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def number(value: float) -> str:
    """Return a number with three digits, more where it is larger."""
    if abs(value) >= 100.0:
        return f"{value:.0f}"
    return f"{value:.3g}"


def _line(line: Line) -> str:
    bar = "" if line.bar is None else str(line.bar)
    unit = "" if line.unit == "x" else f" [{line.unit}]"
    outcome = f"**{line.outcome}**" if line.outcome else ""
    numbers = " | ".join(map(number, (line.median, min(line.values), max(line.values))))
    return f"| {line.what}{unit} | {numbers} | {bar} | {outcome} |\n"


def _result(result: Result) -> str:
    if result.skipped:
        return f"Not measured: {result.skipped}.\n"
    said = "".join(f"\n{sentence}\n" for sentence in result.said)
    return table(result.lines) + said


def _facts(facts: Mapping[str, Any]) -> str:
    rows = "".join(f"| {name} | {_shown(value)} |\n" for name, value in facts.items())
    return f"| measured | |\n| --- | --- |\n{rows}"


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {content}" for name, content in value.items())
    return str(value)


def _summary(results: Mapping[str, Result]) -> str:
    lines = [line for result in results.values() for line in result.lines if line.bar is not None]
    fails = missed(results)
    text = f"{len(lines) - len(fails)} of {len(lines)} bars are met."
    if fails:
        text += f" Missed: {'; '.join(fails)}."
    return text + "\n"
