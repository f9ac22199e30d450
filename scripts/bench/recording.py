# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings of the robot at the benchmark's rates, as bytes of messages and as bags."""

import hashlib
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from bench.rates import EVERY_COMPASS, EVERY_FIX, STEP_NS
from bench.results import Context
from bench.robot import GEOMETRY, MEASUREMENT_STD, drive

START_NS = 3 * 10**9
"""ROS time at which the recording begins [ns]: ROS time 0 means no time."""
SEED = 1
"""Seed of the recording, fixed: every run measures the same work."""
TYPES = {
    "/compass": "sensor_msgs/msg/Imu",
    "/lrf_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/left_ticks": "std_msgs/msg/Int32",
    "/right_ticks": "std_msgs/msg/Int32",
}
"""Types of the messages, by topic."""
STAMPED = ("/compass", "/lrf_pose")
"""Topics whose messages have a stamp, which `stamped` sets."""
LEFT_TICKS, RIGHT_TICKS = "/left_ticks", "/right_ticks"
"""Topics of the wheels."""
_STAMP_AT = 4
"""Offset of the stamp in the CDR of a message that begins with a header [bytes]."""
TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
"""Types of ROS 2 Jazzy, for rosbags."""
_TYPES = TYPESTORE.types
"""Message classes by the names of their types."""


class Sent(NamedTuple):
    """A message of the robot.

    Attributes:
        time_ns: when it is sent [ns].
        topic: absolute name.
        data: the message in CDR.
    """

    time_ns: int
    topic: str
    data: bytes


def sent(seconds: float) -> Iterator[Sent]:
    """Yield what the robot sends, slow sensors before ticks where they are due together."""
    steps = round(seconds * 1e9) // STEP_NS
    drove = drive(steps, 1, STEP_NS * 1e-9, SEED)
    half = 0.5 * GEOMETRY["wheel_separation"] * drove.control[:, 0, 1]
    distance = drove.control[:, 0, 0]
    circumference = 2.0 * np.pi * GEOMETRY["wheel_radius"]
    per_meter = GEOMETRY["encoder_counts_per_revolution"] / circumference
    ticks = {
        LEFT_TICKS: np.floor(np.cumsum(distance - half) * per_meter).astype(int).tolist(),
        RIGHT_TICKS: np.floor(np.cumsum(distance + half) * per_meter).astype(int).tolist(),
    }
    for step in range(steps):
        time_ns = START_NS + (step + 1) * STEP_NS
        z = drove.measurement[step, 0].tolist()
        if step % EVERY_COMPASS == 0:
            yield Sent(time_ns, "/compass", _cdr(_compass(time_ns, z[2]), "/compass"))
        if step % EVERY_FIX == 0:
            yield Sent(time_ns, "/lrf_pose", _cdr(_fix(time_ns, z), "/lrf_pose"))
        for topic, counts in ticks.items():
            yield Sent(time_ns, topic, _cdr(_TYPES["std_msgs/msg/Int32"](counts[step]), topic))


def stamped(message: Sent, time_ns: int) -> bytes:
    """Return a message's bytes with another stamp, if its type has one."""
    if message.topic not in STAMPED:
        return message.data
    seconds, rest = divmod(time_ns, 10**9)
    stamp = seconds.to_bytes(4, "little") + rest.to_bytes(4, "little")
    return message.data[:_STAMP_AT] + stamp + message.data[_STAMP_AT + len(stamp) :]


def bag(context: Context, seconds: int) -> Path:
    """Return a bag of the robot's messages, written unless the same code has done so before."""
    code = [Path(__file__), *map(Path(__file__).with_name, ("robot.py", "rates.py"))]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in code)).hexdigest()[:8]
    folder = context.build / f"recording_{seconds}_{digest}"
    if (folder / "metadata.yaml").is_file():
        return folder
    context.say(f"writing {folder}")
    remove(folder)
    with writer(folder) as out:
        connections = connect(out, TYPES)
        for message in sent(seconds):
            out.write(connections[message.topic], message.time_ns, message.data)
    return folder


def writer(folder: Path) -> Writer:
    """Return a writer of bags of the kind that `replay` writes."""
    made = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    made.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    return made


def connect(out: Writer, types: dict[str, str]) -> dict[str, Any]:
    """Announce topics; return their connections by name."""
    return {
        topic: out.add_connection(topic, kind, typestore=TYPESTORE) for topic, kind in types.items()
    }


def copy(source: Path, target: Path) -> None:
    """Write every message of a bag into another one, as the bytes that it is."""
    with Reader(source) as reader, writer(target) as out:
        connections = connect(out, TYPES)
        for connection, time_ns, data in reader.messages():
            out.write(connections[connection.topic], time_ns, data)


def remove(folder: Path) -> None:
    """Remove a bag that is there."""
    with suppress(FileNotFoundError):
        shutil.rmtree(folder)


def _cdr(message: Any, topic: str) -> bytes:
    return bytes(TYPESTORE.serialize_cdr(message, TYPES[topic]))


def _header(time_ns: int, frame: str) -> Any:
    stamp = _TYPES["builtin_interfaces/msg/Time"](time_ns // 10**9, time_ns % 10**9)
    return _TYPES["std_msgs/msg/Header"](stamp, frame)


def _rotation(yaw: float) -> Any:
    return _TYPES["geometry_msgs/msg/Quaternion"](
        0.0, 0.0, float(np.sin(0.5 * yaw)), float(np.cos(0.5 * yaw))
    )


def _compass(time_ns: int, yaw: float) -> Any:
    zero = _TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    unknown = np.array([-1.0] + [0.0] * 8)
    known = np.diag([1e-9, 1e-9, MEASUREMENT_STD[2] ** 2]).ravel()
    return _TYPES["sensor_msgs/msg/Imu"](
        _header(time_ns, "base_link"), _rotation(yaw), known, zero, unknown, zero, unknown
    )


def _fix(time_ns: int, z: list[float]) -> Any:
    variances = np.full(6, 1e-9)
    variances[[0, 1, 5]] = np.square(MEASUREMENT_STD)[[0, 1, 3]]
    point = _TYPES["geometry_msgs/msg/Point"](z[0], z[1], 0.0)
    pose = _TYPES["geometry_msgs/msg/Pose"](point, _rotation(z[3]))
    return _TYPES[TYPES["/lrf_pose"]](
        _header(time_ns, "map"),
        _TYPES["geometry_msgs/msg/PoseWithCovariance"](pose, np.diag(variances).ravel()),
    )
