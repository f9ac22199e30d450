"""The rates of the fake robot's sensors: how many readings, when, and what they say."""

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.fault_files import read_faults
from fnn_ekf_ros.parameters.faults import Fault
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.simulation.fake_robot import FakeRobot

START_NS = 3 * 10**9
EXAMPLE = Path(__file__).resolve().parents[2] / "config" / "faults_example.yaml"


class Entry(NamedTuple):
    """A message that is sent: at what time [ns], and what."""

    time_ns: int
    topic: str
    message: Message

    @property
    def stamp_ns(self) -> int:
        stamp = self.message.fields["header"].fields["stamp"].fields
        return int(stamp["sec"] * 10**9 + stamp["nanosec"])


def drive(
    seconds: float, faults: Sequence[Fault] = (), start_ns: int = START_NS, **changes: Any
) -> list[Entry]:
    """Return what a robot sends."""
    robot = FakeRobot(build(FakeRobotParameters, changes), start_ns, faults)
    sent: list[Entry] = []
    for _ in range(round(seconds * 80)):
        sent += [Entry(robot.time_ns, *entry) for entry in robot.step()]
    return sent


def digest(entries: Sequence[Entry]) -> str:
    """Return a hash of messages, in order; numbers to six digits after the point."""
    found = hashlib.sha256()
    for entry in entries:
        found.update(repr((entry.time_ns, entry.topic, rounded(entry.message))).encode())
    return found.hexdigest()[:16]


def rounded(field: Any) -> Any:
    """Return a message as lists and numbers, without what another processor's sine changes."""
    if isinstance(field, Message):
        return (field.type_name, {name: rounded(value) for name, value in field.fields.items()})
    if isinstance(field, list | np.ndarray):
        return [rounded(entry) for entry in field]
    return round(float(field), 6) + 0.0 if isinstance(field, float) else field


def test_the_default_rates_send_what_they_always_have(tmp_path: Path) -> None:
    """Hashes from before the rates were parameters."""
    assert digest(drive(10.0)) == "7d832e481269fc13"
    assert (
        digest(drive(10.0, start_ns=1_700_000_000_123_456_789, path="sim1", seed=8))
        == "7c7dcd249f5669b8"
    )
    faults = tmp_path / "faults.yaml"
    # Ten times as fast, so that each fault has its turn.
    faults.write_text(re.sub(r"(start|duration): (\d+)\.0", r"\1: \2e-1", EXAMPLE.read_text()))
    assert digest(drive(30.0, read_faults(str(faults)).faults, seed=9)) == "359fa12a196157c3"
