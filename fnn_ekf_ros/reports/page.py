# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The report of a run: one page with numbers, verdicts and pictures that opens offline."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.evaluation.consistency import Consistency, Verdict, in_words
from fnn_ekf_ros.evaluation.evaluation import (
    AgainstTruth,
    Evaluation,
    distance_driven,
    nees_of,
    number,
)
from fnn_ekf_ros.evaluation.innovations import FIX_YAW
from fnn_ekf_ros.files.text_files import write_text
from fnn_ekf_ros.files.yaml_text import load_yaml
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import fields_of
from fnn_ekf_ros.recordings.run_record import RunRecord
from fnn_ekf_ros.reports import run_captions, run_figures
from fnn_ekf_ros.reports.drawing import Clock
from fnn_ekf_ros.reports.findings import Finding
from fnn_ekf_ros.reports.map_figure import map_figure
from fnn_ekf_ros.reports.plots import credible
from fnn_ekf_ros.timeline.events import Level
from fnn_ekf_ros.timeline.trajectory import Trajectory

TEMPLATE = "report.html.j2"
"""The page's template, beside this module."""
MOST_MESSAGES = 15
"""Largest number of messages of /diagnostics that are listed."""
_CLASSES = {Verdict.HONEST: "ok", Verdict.TOO_SURE: "bad", Verdict.TOO_CAUTIOUS: "warn",
            Verdict.UNKNOWN: ""}  # fmt: skip
"""How verdicts are shown."""


class NumberRow(NamedTuple):
    """A row of the table of numbers.

    Attributes:
        name: what was measured.
        value: with its unit.
        words: what it means; may be empty.
        level: `ok`, `warn`, `bad` or empty: how the words are shown.
    """

    name: str
    value: str
    words: str = ""
    level: str = ""


class Picture(NamedTuple):
    """A picture with its heading and caption.

    Attributes:
        title: the heading.
        svg: the picture.
        caption: what to see in it.
    """

    title: str
    svg: str
    caption: str


class Remark(NamedTuple):
    """A message of /diagnostics.

    Attributes:
        status: which part said it.
        level: how it is shown.
        message: in words.
        first: when it came first.
        share: how often, of the reports.
    """

    status: str
    level: str
    message: str
    first: str
    share: str


def require_jinja2() -> None:
    """Check that pages can be made.

    Raises:
        FnnEkfError: jinja2 is not installed.
    """
    try:
        import jinja2
    except ImportError:
        raise FnnEkfError("reports need jinja2: install it, or fnn_ekf_ros[tools]") from None
    del jinja2


def write_page(
    path: Path,
    label: str,
    run: RunRecord,
    truth: Trajectory | None,
    found: Evaluation,
    findings: Sequence[Finding] | None = None,
) -> None:
    """Write the report of a run.

    Args:
        path: the page.
        label: the run's name.
        run: what the localizer published.
        truth: the ground truth; None without one.
        found: the evaluation.
        findings: of doctor; None if it was not asked.

    Raises:
        FnnEkfError: jinja2 or matplotlib is not installed, or the page cannot be written.
    """
    write_text(path, page_text(label, run, truth, found, findings))


def page_text(
    label: str,
    run: RunRecord,
    truth: Trajectory | None,
    found: Evaluation,
    findings: Sequence[Finding] | None = None,
) -> str:
    """Return the page that `write_page` writes.

    Raises:
        FnnEkfError: jinja2 or matplotlib is not installed.
    """
    require_jinja2()
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("fnn_ekf_ros.reports", "."), autoescape=True,
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    clock = Clock.of(run.track)
    return environment.get_template(TEMPLATE).render(
        label=label,
        facts=_facts(run, truth, found),
        warnings=[] if found.truth is None else found.truth.warnings,
        has_truth=found.truth is not None,
        numbers=number_rows(run, found),
        findings=findings,
        pictures=_pictures(run, truth, found, clock),
        remarks=_remarks(run, clock),
        parameters=_parameters(run.parameters),
    )


def number_rows(run: RunRecord, found: Evaluation) -> list[NumberRow]:
    """Return the table of numbers: errors, then consistency, then what the sensors did."""
    rows = [] if found.truth is None else _error_rows(found.truth)
    if found.truth is not None:
        rows += [_consistency_row(name, each, expected, "errors")
                 for name, each, expected in nees_of(found.truth) if each.size]  # fmt: skip
    if found.nis.size:
        rows.append(_consistency_row("NIS per degree of freedom", found.nis, 1, "innovations"))
    for name, sensor in found.sensors.items():
        rows.append(_consistency_row(f"NIS of {name}", sensor.consistency, 1, "innovations"))
        white = sensor.whiteness
        rows.append(
            NumberRow(
                f"Lag 1 of {name}", f"{white.lag_one:.2f} (white: +-{white.band:.2f})",
                "white: nothing left to learn" if white.white else
                "not white: errors last, or the noise of the wheels is wrong",
                "ok" if white.white else "warn",
            )
        )  # fmt: skip
        if sensor.rejected and name != FIX_YAW:
            rows.append(NumberRow(f"Rejected {name}", f"{sensor.rejected_share:.1%}",
                                  f"{sensor.rejected} of {sensor.readings} readings"))  # fmt: skip
    worst = run.worst_status()
    if worst is not None:
        shown = "warn" if worst.level == Level.WARN else "bad"
        rows.append(NumberRow("Worst status", worst.word, str(worst), shown))
    elif run.statuses:
        rows.append(NumberRow("Worst status", "OK", "all statuses OK", "ok"))
    return rows


def _error_rows(against: AgainstTruth) -> list[NumberRow]:
    """Return the rows of errors against the truth."""
    e, relative = against.errors, against.relative
    rows = []
    for name, sizes, unit in (
        ("Position error (ATE)", e.position, "m"), ("Error in x", e.x, "m"),
        ("Error in y", e.y, "m"), ("Error of yaw", e.yaw, "rad"),
    ):  # fmt: skip
        if np.isfinite(sizes.rmse):
            words = f"median {sizes.median:.3g}, largest {sizes.max:.3g} {unit}"
            rows.append(NumberRow(name, f"RMSE {sizes.rmse:.3g} {unit}", words))
    if relative.pairs and np.isfinite(relative.translation.rmse):
        rows.append(
            NumberRow(f"Relative error (RPE, {relative.delta})",
                      f"RMSE {relative.translation.rmse:.3g} m",
                      f"and {relative.rotation.rmse:.3g} rad, of {relative.pairs} pairs")
        )  # fmt: skip
    return rows


def _consistency_row(name: str, found: Consistency, expected: int, whose: str) -> NumberRow:
    mean, low, high = (expected * value for value in (found.ratio, found.low, found.high))
    if not found.size:
        return NumberRow(name, "not known")
    return NumberRow(
        name, f"{number(mean)} (honest: {low:.2f} to {high:.2f})", in_words(found, whose),
        _CLASSES[found.verdict],
    )  # fmt: skip


def _facts(run: RunRecord, truth: Trajectory | None, found: Evaluation) -> list[str]:
    """Return the run in a few words."""
    time_ns = run.track.time_ns
    driven = distance_driven(run.track)
    facts = [
        f"{(time_ns[-1] - time_ns[0]) * 1e-9:.0f} s",
        f"{driven:.0f} m",
        f"{len(time_ns)} odom",
    ]
    if run.fixes is not None:
        facts.append(f"{len(run.fixes.time_ns)} fixes")
    if found.truth is not None:
        facts.append(f"ground truth at {found.truth.errors.poses} odom")
    elif truth is None:
        facts.append("no ground truth")
    return facts


def _pictures(
    run: RunRecord, truth: Trajectory | None, found: Evaluation, clock: Clock
) -> list[Picture]:
    pictures = [
        Picture("Map", map_figure(run, truth, found),
                run_captions.map_caption(found, clock))
    ]  # fmt: skip
    if found.truth is not None:
        pictures.append(
            Picture("Errors", run_figures.error_figure(found.truth.matched, clock),
                    run_captions.error_caption(found.truth.matched))
        )  # fmt: skip
    else:
        std = np.sqrt(credible(run.track.covariance[:, 0, 0]))
        if np.any(np.isfinite(std)):
            pictures.append(
                Picture("Uncertainty", run_figures.claim_figure(run, clock),
                        run_captions.claim_caption(std[np.isfinite(std)]))
            )  # fmt: skip
    noise = run.noise
    if noise is not None:
        pictures += [
            Picture("Noise found", run_figures.noise_figure(noise, clock),
                    run_captions.noise_caption(noise)),
            Picture("Innovations", run_figures.innovation_figure(noise, clock),
                    run_captions.innovation_caption(noise)),
            Picture("Lasting errors", run_figures.lasting_figure(noise, clock),
                    run_captions.lasting_caption(noise)),
        ]  # fmt: skip
    pictures.append(
        Picture("Diagnostics", run_figures.diagnostics_figure(run, clock),
                run_captions.diagnostics_caption(run))
    )  # fmt: skip
    return [picture for picture in pictures if picture.svg]


def _remarks(run: RunRecord, clock: Clock) -> list[Remark]:
    """Return what /diagnostics said that was not OK, the most frequent first."""
    remarks = []
    for status, reports in run.statuses.items():
        seen: dict[tuple[int, str], list[int]] = {}
        for report in reports:
            if report.level > 0:
                seen.setdefault((report.level, report.message), []).append(report.time_ns)
        for (level, message), times in seen.items():
            first = run_captions.time_text(clock, times[0])
            shown = "warn" if level == 1 else "bad"
            remark = Remark(status, shown, message, first, f"{len(times) / len(reports):.1%}")
            remarks.append((len(times), remark))
    remarks.sort(key=lambda entry: -entry[0])
    return [remark for _, remark in remarks[:MOST_MESSAGES]]


def _parameters(text: str) -> list[tuple[str, str, str, bool]]:
    """Return name, value, default and whether they differ, of the parameters that were used."""
    content: Any = (
        load_yaml(text, "parameters in the bag's metadata", FnnEkfError) if text else None
    )
    used: dict[str, Any] = {}
    for section in content.values() if isinstance(content, dict) else ():
        if isinstance(section, dict):
            used.update(section.get("ros__parameters") or {})
    defaults = {name: default for name, _, default in fields_of(LocalizerParameters)}
    rows = []
    for name, value in used.items():
        shown, default = _value(value), _value(defaults[name]) if name in defaults else ""
        rows.append((name, shown, default, shown != default))
    return rows


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(entry) for entry in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return "not set" if value != value else f"{value:.4g}"
    return str(value) if value != "" else '""'
