# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Views for RViz, Foxglove and PlotJuggler: they show what is published. Needs no ROS."""

import json
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import yaml
from places import ROOT

from fnn_ekf_ros import cli, messages
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import default_of
from fnn_ekf_ros.recordings.bag_files import BagReader


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The last message of each topic of the fake robot and the localizer, by absolute name."""
    folder = tmp_path_factory.mktemp("published")
    run, out = str(folder / "run"), str(folder / "out")
    assert cli.run_command("simulate", [run, "--duration", "15"]) == 0
    assert cli.run_command("replay", [run, out, "--params", f"{run}.yaml"]) == 0
    with BagReader(folder / "out") as bag:
        return {record.topic: bag.message(record) for record in bag.records()}


def type_of(message: Any) -> str:
    return str(message.__msgtype__)


def test_rviz_shows_topics_that_exist_in_the_frame_they_are_in(published: dict[str, Any]) -> None:
    content = yaml.safe_load((ROOT / "config" / "localizer.rviz").read_text())
    manager = content["Visualization Manager"]
    frame = manager["Global Options"]["Fixed Frame"]
    expected = {"Odometry": messages.ODOMETRY_TYPE, "PoseWithCovariance": messages.POSE_TYPE}
    shown: dict[str, list[dict[str, Any]]] = {}
    for display in manager["Displays"]:
        package, kind = display["Class"].split("/")
        assert package == "rviz_default_plugins"
        assert display["Enabled"]
        if kind in ("Grid", "TF"):
            continue
        topic = display["Topic"]["Value"]
        shown.setdefault(topic, []).append(display)
        assert type_of(published[topic]) == expected[kind], display["Name"]
        assert published[topic].header.frame_id == frame, display["Name"]
    assert set(shown) == {"/odom", "/lrf_pose", "/ground_truth"}
    assert {(d["Keep"] > 100, d["Covariance"]["Value"]) for d in shown["/odom"]} == {
        (False, True), (True, False),
    }  # fmt: skip
    assert frame == default_of(LocalizerParameters, "frame_id")
    (tool,) = [t for t in manager["Tools"] if t["Class"].endswith("/SetInitialPose")]
    assert tool["Topic"]["Value"] == messages.absolute_name(messages.INITIAL_POSE)
    assert messages.INPUT_TYPES[messages.INITIAL_POSE] == messages.POSE_TYPE


def at_path(published: dict[str, Any], path: str) -> Any:
    """Return what a Foxglove message path leads to: fields, [index], {filter}, .@function."""
    topic = max((t for t in published if path.startswith(f"{t}.")), key=len, default=None)
    assert topic is not None, path
    found, rest = published[topic], path[len(topic) :]
    while rest:
        step = re.match(
            r"\.@(?P<function>\w+)$|\.(?P<field>\w+)|\[(?P<index>\d+|:)\]"
            r'|\{(?P<key>\w+)=="(?P<value>[^"]*)"\}',
            rest,
        )
        assert step is not None, f"{path}: {rest}"
        rest = rest[step.end() :]
        if step["function"]:
            found = {"sqrt": np.sqrt}[step["function"]](found)
        elif step["field"]:
            found = getattr(found, step["field"])
        elif step["key"]:
            (found,) = [e for e in found if getattr(e, step["key"]) == step["value"]]
        elif step["index"] != ":":
            found = found[int(step["index"])]
    return found


def panels_in(layout: Any) -> Iterator[str]:
    """Yield the panels of a Foxglove layout."""
    if isinstance(layout, str):
        yield layout
    else:
        assert layout["direction"] in ("row", "column")
        yield from panels_in(layout["first"])
        yield from panels_in(layout["second"])


def test_foxglove_shows_topics_and_fields_that_exist(published: dict[str, Any]) -> None:
    content = json.loads((ROOT / "config" / "foxglove_layout.json").read_text())
    panels = content["configById"]
    assert sorted(panels_in(content["layout"])) == sorted(panels)
    paths: list[str] = []
    for name, panel in panels.items():
        kind = name.partition("!")[0]
        if kind == "Plot":
            paths += [s["value"] for s in panel["paths"]]
            if panel["xAxisVal"] == "custom":
                paths.append(panel["xAxisPath"]["value"])
        elif kind == "StateTransitions":
            paths += [s["value"] for s in panel["paths"]]
        elif kind == "3D":
            frame = default_of(LocalizerParameters, "frame_id")
            frames = {frame, default_of(LocalizerParameters, "base_frame")}
            assert panel["followTf"] == panel["layers"]["grid"]["frameId"] == frame
            assert panel["transforms"].keys() == {f"frame:{name}" for name in frames}
            assert {type_of(published[t]) for t in panel["topics"]} == {messages.POSE_TYPE}
            tool = panel["publish"]["poseEstimateTopic"]
            assert tool == messages.absolute_name(messages.INITIAL_POSE)
        else:
            assert kind in ("DiagnosticSummary", "DiagnosticStatusPanel")
            statuses = published[panel["topicToRender"]].status
            shown = (panel.get("selectedHardwareId"), panel.get("selectedName"))
            assert shown in {(None, None), *((s.hardware_id, s.name) for s in statuses)}
    for path in paths:
        if not re.fullmatch(r"[\d.]+", path):  # a line at a number
            assert np.isfinite(float(at_path(published, path))), path
    text = " ".join(paths)
    for topic in (*messages.NUMBER_TOPICS, "odom", "lrf_pose", "ground_truth"):
        assert f"/{topic}." in text, topic
    assert "/odom.pose.covariance" in text
    levels = {s.name for s in published["/diagnostics"].status}
    assert levels == set(re.findall(r'name=="([^"]*)"', text))


def series_of(topic: str, message: Any) -> Iterator[str]:
    """Yield the names of the numeric series that PlotJuggler makes of a message."""
    kind = type_of(message)
    if kind == messages.DIAGNOSTICS_TYPE:
        yield from (f"{topic}/{s.hardware_id}/{s.name}/level" for s in message.status)
    elif kind == "geometry_msgs/msg/Quaternion":
        yield from (f"{topic}/{name}" for name in ("x", "y", "z", "w", "roll", "pitch", "yaw"))
    else:
        for name in message.__dataclass_fields__:
            value = getattr(message, name)
            if hasattr(value, "__msgtype__"):
                yield from series_of(f"{topic}/{name}", value)
            elif name == "covariance":
                yield from (f"{topic}/{name}/[{i};{j}]" for i in range(6) for j in range(i, 6))
            elif isinstance(value, int | float):
                yield f"{topic}/{name}"


def test_plotjuggler_shows_series_that_exist(published: dict[str, Any]) -> None:
    root = ElementTree.parse(ROOT / "config" / "plotjuggler_layout.xml").getroot()
    known = {name for topic, message in published.items() for name in series_of(topic, message)}
    shown: set[str] = set()
    for plot in root.iter("plot"):
        for curve in plot.iter("curve"):
            is_xy = plot.get("mode") == "XYPlot"
            names = ("curve_x", "curve_y") if is_xy else ("name",)
            shown |= {str(curve.get(name)) for name in names}
    assert shown <= known
    (selected,) = root.iter("selected_topics")
    topics = str(selected.get("value")).split(";")
    assert set(topics) <= published.keys()
    assert {t for t in published for s in shown if s.startswith(f"{t}/")} - set(topics) <= {
        f"/{NODE_NAME}/{messages.NOISE}"  # the start of its numbers' names
    }
    for topic in messages.NUMBER_TOPICS:
        assert f"/{NODE_NAME}/{topic}/data" in shown
    assert {f"/{t}/pose/pose/position/x" for t in ("odom", "lrf_pose", "ground_truth")} <= shown
    assert "/odom/pose/covariance/[0;0]" in shown
    levels = {
        f"/diagnostics/{s.hardware_id}/{s.name}/level" for s in published["/diagnostics"].status
    }
    assert levels <= shown
    for splitter in root.iter("DockSplitter"):
        assert int(str(splitter.get("count"))) == len(splitter)
        assert len(str(splitter.get("sizes")).split(";")) == len(splitter)
