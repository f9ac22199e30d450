# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Timelines of faults: YAML lists that become checked values, and the vocabulary as a table."""

import itertools
import math
import reprlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from fnn_ekf_ros.files.fields import Fields
from fnn_ekf_ros.files.text_files import read_text
from fnn_ekf_ros.files.yaml_text import load_yaml
from fnn_ekf_ros.parameters.faults import FAULTS, GROUPS, NAMES, TO_THE_END_S, Fault
from fnn_ekf_ros.parameters.schema import (
    NO_FILE,
    ParameterError,
    ParameterValue,
    Spec,
    build,
    fields_of,
)

EXAMPLE = "{fault: dropout, topic: compass, start: 60.0, duration: 5.0}"
"""An entry of a timeline, for error messages."""


class FaultError(ParameterError):
    """A timeline of faults that cannot be read or does not make sense."""


class Timeline(NamedTuple):
    """The faults of a run.

    Attributes:
        faults: in the file's order.
        text: the file as it was read; empty without a file.
    """

    faults: tuple[Fault, ...] = ()
    text: str = ""


def read_faults(faults_file: str) -> Timeline:
    """Return the timeline that the parameter `faults_file` names.

    Args:
        faults_file: a path, or `none`.

    Raises:
        FaultError: the file cannot be read, or an entry of it is wrong.
    """
    if faults_file == NO_FILE:
        return Timeline()
    text = read_text(Path(faults_file), "faults_file", FaultError)
    where = f"faults_file '{faults_file}'"
    content = load_yaml(text, where, FaultError, unique_keys=True)
    if not isinstance(content, list):
        raise FaultError(
            f"{where} holds {reprlib.repr(content)}: expected a list of faults such as - {EXAMPLE}"
        )
    return Timeline(faults_from(content, where), text)


def faults_from(entries: Sequence[Any], where: str = "faults") -> tuple[Fault, ...]:
    """Return the faults of a list of mappings, as YAML holds them.

    Args:
        entries: each with its `fault` and that fault's keys.
        where: what holds them, for the error's first words.

    Raises:
        FaultError: an unknown fault or key, a missing one, a wrong value, or twice the same at
            the same time.
    """
    faults = tuple(
        _fault(entry, f"{where}, entry {number}") for number, entry in enumerate(entries, start=1)
    )
    _refuse_overlaps(faults, where)
    return faults


def vocabulary_table() -> str:
    """Return the faults with their keys as Markdown: a table for each group."""
    lines: list[str] = []
    for group, kinds in GROUPS.items():
        lines += ["", f"### {group}", "", "| fault | key | meaning | range | default |"]
        lines.append("|---|---|---|---|---|")
        for name, kind in kinds.items():
            sentence = " ".join((kind.__doc__ or "").split())
            lines.append(f"| **`{name}`** | | **{sentence}** | | |")
            for key, spec, default in fields_of(kind):
                unit = f" [{spec.unit.strip('[]')}]" if spec.unit else ""
                words = ", ".join(f"`{word}`" for word in spec.choices) or spec.limits
                lines.append(
                    f"| | `{key}` | {spec.doc}{unit} | {words} | {_shown_default(spec, default)} |"
                )
    return "\n".join(lines[1:]) + "\n"


def _fault(entry: Any, where: str) -> Fault:
    keys_of_a_fault = f"the keys of a fault, such as {EXAMPLE}"
    name = Fields(entry, where, FaultError, keys_of_a_fault).choice("fault", FAULTS)
    kind = FAULTS[name]
    where = f"{where} ({name})"
    values = {key: value for key, value in entry.items() if key != "fault"}
    specs = {key: spec for key, spec, _ in fields_of(kind)}
    required = {key: _expected(spec) for key, spec in specs.items() if spec.required}
    Fields(values, where, FaultError, keys_of_a_fault).check_keys(specs, required)
    try:
        return build(kind, values)
    except ParameterError as error:
        raise FaultError(f"{where}: {error}") from None


def _refuse_overlaps(faults: Sequence[Fault], where: str) -> None:
    """Refuse the same fault of the same wheel or topic twice at a time: it has one size."""
    spans: dict[tuple[str, str], list[tuple[float, float, int]]] = {}
    for number, fault in enumerate(faults, start=1):
        for target in fault.targets():
            spans.setdefault((NAMES[type(fault)], target), []).append(
                (fault.start, fault.end, number)
            )
    for (name, target), times in spans.items():
        for one, other in itertools.pairwise(sorted(times)):
            if other[0] < one[1] or other[0] == one[0]:
                first, second = sorted((one[2], other[2]))
                raise FaultError(
                    f"{where}, entries {first} and {second}: {name} of {target} twice at "
                    f"{other[0]:g} s: expected one at a time"
                )


def _expected(spec: Spec) -> str:
    if spec.choices:
        return f"one of {', '.join(spec.choices)}"
    kind = "a list of numbers" if spec.unit.startswith("[") else "a number"
    unit = f"[{spec.unit.strip('[]')}]" if spec.unit else ""
    return " ".join(filter(None, [kind, spec.limits, unit]))


def _shown_default(spec: Spec, default: ParameterValue) -> str:
    if spec.required:
        return "must be given"
    if default == TO_THE_END_S:
        return "to the end"
    if isinstance(default, tuple) and math.isnan(default[0]):
        return "not set"
    return f"{default:g}" if isinstance(default, float) else str(default)
