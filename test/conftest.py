# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What the unit tests share: parameters, pipelines, simulated runs, commands and bags."""

import functools
import signal
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from localizers import GEOMETRY, START_NS, Arrival, Run

from fnn_ekf_ros import messages
from fnn_ekf_ros.cli import run_command
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.simulation.fake_robot import FakeRobot
from fnn_ekf_ros.timeline.events import Output, Rejected

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""What commands and nodes handle themselves."""


class Ran(NamedTuple):
    """How a command ended."""

    code: int
    out: str
    err: str


@pytest.fixture(scope="session")
def geometry() -> dict[str, float]:
    """The paper's robot, as localizer parameters."""
    return dict(GEOMETRY)


@pytest.fixture(scope="session")
def make_parameters() -> Callable[..., LocalizerParameters]:
    """Localizer parameters of the paper's robot, with changes."""

    def make(**changes: Any) -> LocalizerParameters:
        return build(LocalizerParameters, GEOMETRY | changes)

    return make


@pytest.fixture(scope="session")
def make_pipeline(
    make_parameters: Callable[..., LocalizerParameters],
) -> Callable[..., Localizer]:
    """A pipeline for the paper's robot, with changed parameters."""

    def make(**changes: Any) -> Localizer:
        parameters = make_parameters(**changes)
        return Localizer(parameters, networks_for(parameters))

    return make


@pytest.fixture(scope="session")
def feed() -> Callable[[Localizer, Iterable[Arrival]], list[Output]]:
    """Feeds arrivals to a pipeline and returns all it gives."""

    def run(pipeline: Localizer, arrivals: Iterable[Arrival]) -> list[Output]:
        return [output for now, event in arrivals for output in pipeline.add(event, now)]

    return run


@pytest.fixture(scope="session")
def arrival() -> type[Arrival]:
    """The class of arrivals."""
    return Arrival


@pytest.fixture(scope="session")
def as_object() -> Callable[[Message], Any]:
    """Makes an object with attributes of a message tree, as rclpy or rosbags would."""
    return _as_object


@pytest.fixture(scope="session")
def simulated(make_parameters: Callable[..., LocalizerParameters]) -> Callable[..., Run]:
    """Simulated runs, as a localizer with ticks or joint_states would read them; kept."""

    @functools.cache
    def simulate(seed: int, seconds: float, source: str = "ticks", **robot: Any) -> Run:
        listening = make_parameters(encoder_source=source)
        topics = messages.input_topics(listening)
        fake = FakeRobot(build(FakeRobotParameters, {"seed": seed, **robot}), START_NS)
        arrivals: list[Arrival] = []
        truth: dict[int, FloatArray] = {}
        while fake.stamp_ns < START_NS + seconds * 1e9:
            for sent in fake.step():
                if sent.topic == messages.GROUND_TRUTH:
                    truth[fake.stamp_ns] = messages.planar_pose(_as_object(sent.message))
                elif sent.topic in topics:
                    events = messages.read_input(
                        sent.topic, _as_object(sent.message), fake.stamp_ns, listening
                    )
                    assert not isinstance(events, Rejected)
                    arrivals += [Arrival(fake.stamp_ns, event) for event in events]
        return Run(tuple(arrivals), truth)

    return simulate


@pytest.fixture(scope="session")
def same_estimates() -> Callable[[list[Output], list[Output]], None]:
    """Asserts that two lists of outputs hold the same states, bit for bit."""

    def compare(first: list[Output], second: list[Output]) -> None:
        assert [o.stamp_ns for o in first] == [o.stamp_ns for o in second]
        for one, other in zip(first, second, strict=True):
            assert (one.estimate is None) == (other.estimate is None)
            if one.estimate is None or other.estimate is None:
                continue
            np.testing.assert_array_equal(one.estimate.twist, other.estimate.twist)
            for name in ("mean", "covariance", "process_noise", "measurement_noise"):
                np.testing.assert_array_equal(
                    getattr(one.estimate.state, name),
                    getattr(other.estimate.state, name),
                    err_msg=f"{name} at {one.stamp_ns} ns",
                )

    return compare


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Iterator[Callable[..., Ran]]:
    """Runs a command as from a shell; afterwards signals do again what they did."""
    before = {number: signal.getsignal(number) for number in SIGNALS}

    def command(name: str, *argv: object) -> Ran:
        capsys.readouterr()
        code = run_command(name, [str(word) for word in argv])
        caught = capsys.readouterr()
        return Ran(code, caught.out, caught.err)

    yield command
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def succeed(run: Callable[..., Ran]) -> Callable[..., str]:
    """Runs a command that must succeed and say nothing on stderr; returns what it prints."""

    def command(name: str, *argv: object) -> str:
        ran = run(name, *argv)
        assert (ran.code, ran.err) == (0, "")
        return ran.out

    return command


@pytest.fixture
def refuse(run: Callable[..., Ran], tmp_path: Path) -> Callable[..., str]:
    """Runs a command that must fail in one line and leave nothing behind; returns the line."""

    def command(name: str, *argv: object) -> str:
        before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
        ran = run(name, *argv)
        assert ran.code == 1
        assert ran.out == ""
        assert ran.err.startswith(f"{name}: ")
        assert ran.err.endswith("\n")
        assert ran.err.count("\n") == 1, ran.err
        assert "Traceback" not in ran.err
        after = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
        assert after == before
        return ran.err.rstrip("\n")

    return command


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated recording of 15 s; `recorded.yaml` beside it has the matching parameters."""
    out = tmp_path_factory.mktemp("recorded") / "recorded"
    assert run_command("simulate", [str(out), "--duration", "15", "-p", "seed:=5"]) == 0
    return out


def _as_object(field: Any) -> Any:
    if isinstance(field, Message):
        return SimpleNamespace(**{name: _as_object(v) for name, v in field.fields.items()})
    if isinstance(field, list):
        return [_as_object(entry) for entry in field]
    return field
