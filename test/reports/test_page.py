# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The report: one file without links, with numbers, verdicts, pictures and what a bag lacks."""

import json
import re
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from tracks import noisy, wiggling

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.evaluation.evaluation import evaluate
from fnn_ekf_ros.messages import NOISE_FIELDS
from fnn_ekf_ros.recordings.run_record import Fixes, Noise, RunRecord, StatusReport
from fnn_ekf_ros.reports.findings import Finding, read_findings
from fnn_ekf_ros.timeline.trajectory import Trajectory

pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

from fnn_ekf_ros.reports.page import number_rows, page_text
from fnn_ekf_ros.reports.svg import COLORS, panels, styled, svg_text

TRUTH = wiggling()


def recorded_run(n: int = len(TRUTH.time_ns)) -> RunRecord:
    """A run with everything a localizer publishes."""
    track, rng = noisy(TRUTH), np.random.default_rng(1)
    time_ns = track.time_ns[:n]
    values = {name: np.zeros(n) for name in NOISE_FIELDS}
    for name in NOISE_FIELDS[:6]:
        values[name] = np.full(n, 0.01)
    for row in ("x", "y", "compass_yaw"):
        values[f"innovation_{row}"] = 0.1 * rng.standard_normal(n)
        values[f"innovation_variance_{row}"] = np.full(n, 0.01)
    values["nis"], values["degrees_of_freedom"] = rng.chisquare(3.0, n), np.full(n, 3.0)
    values["rejected_lrf_pose"][::50] = 1.0
    values["lasting_time_constant"], values["weight_fix_3"] = np.full(n, 40.0), np.full(n, 0.8)
    reports = [StatusReport(int(t), int(i > n // 2), "silent") for i, t in enumerate(time_ns)]
    return RunRecord(
        track=Trajectory(time_ns, track.pose[:n], track.covariance[:n]),
        twist=np.zeros((n, 2)),
        noise=Noise(time_ns, values),
        statuses={"lrf_pose": reports, "time": [StatusReport(int(time_ns[0]), 0, "running")]},
        fixes=Fixes(time_ns, track.pose[:n] + 0.1),
        parameters="/**/localizer:\n  ros__parameters:\n    period: 0.5\n    adaptation: joint\n",
    )


@pytest.fixture(scope="module")
def page() -> str:
    """The page of a run with a ground truth and a finding; names hold markup."""
    run = recorded_run()
    findings = [Finding("bad", "<script>x</script>", (("key", "<b>"),))]
    return page_text("a run <&>", run, TRUTH, evaluate(run, TRUTH), findings)


class Strict(HTMLParser):
    """Finds tags that are not closed in order, and what would be loaded from elsewhere."""

    VOID = {"meta", "br", "hr", "img", "link"}

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        self.links += [
            str(value) for name, value in attrs
            if name in ("src", "href", "xlink:href") and not str(value).startswith("#")
        ]  # fmt: skip

    def handle_startendtag(self, *_: object) -> None:
        """Nothing is opened."""

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.slow
def test_the_page_is_one_file_without_links_and_well_formed(page: str) -> None:
    text = page
    parser = Strict()
    parser.feed(text)
    assert parser.open == []
    assert parser.links == []
    without_names = text.replace("http://www.w3.org/2000/svg", "").replace(
        "http://www.w3.org/1999/xlink", ""
    )
    assert "http" not in without_names
    assert "<script" not in text
    assert "@import" not in text
    assert len(text) < 1_000_000
    for svg in re.findall(r"<svg.*?</svg>", text, flags=re.DOTALL):
        ElementTree.fromstring(svg)


@pytest.mark.slow
def test_pictures_use_the_colors_of_the_page(page: str) -> None:
    text = page
    assert not [color for color in COLORS.values() if color in text]
    defined = set(re.findall(r"(--\w+):", text))
    assert set(re.findall(r"var\((--\w+)\)", text)) <= defined
    for section in ("Map", "Errors", "Innovations", "Noise found", "Lasting errors", "Diagnostics"):
        assert f"<h2>{section}</h2>" in text, section


def test_numbers_of_a_picture_are_rounded_and_its_text_is_not() -> None:
    with styled():
        figure, (axes,) = panels(1, 1.0)
        axes.plot([0.0, 1.23456789], [0.0, 0.002])
        axes.set_yticks([0.00125], ["0.00125"])
        text = svg_text(figure, "rounded")
    assert ">0.00125<" in text
    assert not re.search(r'[ "]d="[^"]*\d\.\d{3}', text)
    assert 'aria-label="rounded"' in text


@pytest.mark.slow
def test_names_of_the_user_are_text_and_no_markup(page: str) -> None:
    text = page
    assert "a run &lt;&amp;&gt;" in text
    assert "&lt;script&gt;" in text
    assert "&lt;b&gt;" in text
    assert "<h2>Findings</h2>" in text


@pytest.mark.slow
def test_without_a_truth_the_page_has_what_needs_none() -> None:
    run = recorded_run()
    text = page_text("run", run, None, evaluate(run, None))
    assert "no ground truth" in text
    assert "<h2>Uncertainty</h2>" in text
    assert "<h2>Findings</h2>" not in text
    assert "<h2>Errors</h2>" not in text
    assert "NEES" not in text
    assert "<h2>Innovations</h2>" in text


@pytest.mark.slow
def test_a_bare_track_has_a_page() -> None:
    track = Trajectory(np.array([0, 10**9]), np.zeros((2, 3)), np.zeros((2, 3, 3)))
    run = RunRecord(track, np.zeros((2, 2)))
    text = page_text("bare", run, None, evaluate(run, None))
    assert "<h2>Map</h2>" in text
    assert "Innovations" not in text


def test_numbers_come_with_verdicts_in_words() -> None:
    run = recorded_run()
    rows = {row.name: row for row in number_rows(run, evaluate(run, TRUTH))}
    assert rows["NEES"].words == "honest"
    assert rows["NEES"].level == "ok"
    assert rows["Position error (ATE)"].value.startswith("RMSE 0.1")
    assert rows["Rejected fixes"].words == "8 of 400 readings"
    assert rows["Worst status"].value == "WARN"
    assert rows["Worst status"].words == "lrf_pose: silent (49.8% of the reports)"


@pytest.mark.slow
def test_parameters_that_differ_from_the_default_come_first_and_are_marked(page: str) -> None:
    text = page
    first, second = re.findall(r"<tr( class=\"changed\")?><td>(\w+)</td><td>([\w.]+)</td>", text)
    assert first == (' class="changed"', "period", "0.5")
    assert second == ("", "adaptation", "joint")


def test_findings_of_several_forms(tmp_path: Path) -> None:
    file = tmp_path / "found.json"
    change = {
        "parameter": "wheel_radius",
        "value": 0.0331234,
        "low": 0.033,
        "high": 0.034,
        "unit": "m",
    }
    of_wheels = {
        "certainty": "certain",
        "sentence": "wheels are larger",
        "changes": [change],
        "n": 3,
    }
    file.write_text(json.dumps({"findings": ["wheels are swapped", of_wheels]}))
    assert read_findings(file) == [
        Finding("warn", "wheels are swapped", ()),
        Finding(
            "bad",
            "wheels are larger",
            (("changes", "wheel_radius: 0.033123 m (0.033 to 0.034)"), ("n", "3")),
        ),
    ]


@pytest.mark.parametrize("text", ["", "{}", '{"findings": 3}', "[7]", '[{"level": "error"}]'])
def test_findings_that_are_none_are_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "found.json"
    file.write_text(text)
    with pytest.raises(FnnEkfError, match=r"found\.json"):
        read_findings(file)
