# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What `doctor` prints and writes."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fnn_ekf_ros.calibration.findings import Certainty, Change, Finding
from fnn_ekf_ros.recordings.bag_facts import TopicFacts

_ROW = "{:<24} {:<42} {:>8} {:>8} {:>8} {:>9}  {}"
"""Format of a row of the table of topics."""


def as_text(
    bag: Path,
    duration_s: float,
    facts: Sequence[TopicFacts],
    findings: Sequence[Finding],
    obstacle: str,
) -> str:
    """Return the report for a terminal."""
    lines = [
        f"{bag}: {duration_s:.1f} s, {sum(fact.messages for fact in facts)} messages",
        "",
        _ROW.format("topic", "type", "messages", "rate", "gap", "latency", "frames, QoS").rstrip(),
        _ROW.format("", "", "", "[Hz]", "[s]", "[s]", "").rstrip(),
        *(_row(fact) for fact in facts),
        "",
    ]
    wrong = [each for each in findings if each.certainty is not Certainty.POSSIBLE]
    if not wrong:
        lines.append(
            "Nothing is wrong with robot, wiring or configuration as far as this bag shows."
        )
    lines += [finding_line(finding) for finding in findings]
    lines += ["", f"replay would not work: {obstacle}" if obstacle else "replay would work."]
    return "\n".join(lines)


def as_json(
    facts: Sequence[TopicFacts],
    findings: Sequence[Finding],
    estimates: Sequence[Change],
    obstacle: str,
) -> dict[str, Any]:
    """Return the report as JSON can hold it; null where a number is not known."""
    return {
        "topics": [_plain(fact._asdict()) for fact in facts],
        "findings": plain_findings(findings),
        "estimates": [_plain(change._asdict()) for change in estimates],
        "replay_works": not obstacle,
        "obstacle": obstacle,
    }


def plain_findings(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """Return findings as JSON can hold them."""
    return [
        {
            "name": finding.name,
            "sentence": finding.sentence,
            "evidence": finding.evidence,
            "certainty": str(finding.certainty),
            "changes": [_plain(change._asdict()) for change in finding.changes],
            "remaps": list(finding.remaps),
        }
        for finding in findings
    ]


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in values.items()
    }


def _row(fact: TopicFacts) -> str:
    latency = "" if math.isnan(fact.latency_s) else f"{fact.latency_s:.3f}"
    frames = ", ".join(frame for frame in fact.frames if frame)
    delivery = ("" if fact.reliable else "best effort") or ""
    if fact.transient_local:
        delivery = f"{delivery}, transient local".removeprefix(", ")
    notes = "; ".join(part for part in (frames, delivery) if part)
    if fact.backward:
        notes += f"; {fact.backward} stamps go back"
    return _ROW.format(
        fact.name, fact.type_name, fact.messages, f"{fact.rate_hz:.2f}",
        f"{fact.longest_gap_s:.2f}", latency, notes,
    ).rstrip()  # fmt: skip


def finding_line(finding: Finding) -> str:
    """Return a finding as a line: how sure, what, the evidence, what puts it right."""
    remaps = [f"-r {remap}" for remap in finding.remaps]
    remedy = ", ".join([*(change.words() for change in finding.changes), *remaps])
    line = f"{finding.certainty}: {finding.sentence} ({finding.evidence})"
    return f"{line}; {remedy}" if remedy else line
