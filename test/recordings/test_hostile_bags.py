# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings that hang, fill the memory or are something else: one line, and what to do."""

import itertools
import os
import shutil
import sqlite3
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from commands import Refuse, parameters_of
from places import ROOT

from fnn_ekf_ros import messages
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.recordings import rosbags_api
from fnn_ekf_ros.recordings.bag_files import LAST_STAMP_S, BagError, BagReader
from fnn_ekf_ros.recordings.bag_writer import BagWriter
from fnn_ekf_ros.recordings.rosbags_api import LARGEST_CHUNK, mcap

MAGIC = b"\x89MCAP0\r\n"


def text(words: str) -> bytes:
    """Return a string of mcap."""
    return struct.pack("<I", len(words)) + words.encode()


def section(code: int, content: bytes) -> bytes:
    """Return a record of mcap."""
    return struct.pack("<BQ", code, len(content)) + content


def zeros(compression: str, size: int) -> bytes:
    """Return so many zeros, compressed without being in memory."""
    block = bytes(2**24)
    if compression == "zstd":
        packer = mcap.zstd.ZstdCompressor()  # type: ignore[attr-defined]
        return b"".join([packer.compress(block) for _ in range(size // 2**24)]) + bytes(
            packer.flush()
        )
    with rosbags_api.lz4.LZ4FrameCompressor() as packer:
        parts = [packer.begin(), *(packer.compress(block) for _ in range(size // 2**24))]
        return b"".join([*parts, packer.flush()])


def write_mcap(
    path: Path, chunks: list[tuple[int, int, bytes]], compression: str, indexed: bool = True
) -> None:
    """Write an mcap file of chunks: begin and end [ns], the size that they say, the data.

    Args:
        path: the file.
        chunks: of one topic; all begin at 1 ns and end at 2 ns.
        compression: of the data.
        indexed: whether there is an index of the chunks; otherwise they are found by reading.
    """
    out = MAGIC + section(1, text("ros2") + text("by hand"))
    index = b""
    for begin, declared, data in chunks:
        head = struct.pack("<QQQI", begin, begin + 1, declared, 0) + text(compression)
        chunk = section(6, head + struct.pack("<Q", len(data)) + data)
        where = struct.pack("<QQQQ", begin, begin + 1, len(out), len(chunk))
        counts = struct.pack("<IHQQ", 10, 1, len(out) + len(chunk), 0)
        sizes = struct.pack("<QQ", len(data), declared)
        index += section(8, where + counts + text(compression) + sizes)
        out += chunk
    out += section(15, struct.pack("<I", 0))
    schema = (
        struct.pack("<H", 1) + text("std_msgs/msg/Int32") + text("ros2msg") + text("int32 data\n")
    )
    channel = struct.pack("<HH", 1, 1) + text("/left_ticks") + text("cdr") + struct.pack("<I", 0)
    start = len(out) if indexed else 0
    statistics = struct.pack("<QHIIIIQQI", 1, 1, 1, 0, 0, len(chunks), 1, 2, 10)
    if indexed:
        out += section(3, schema) + section(4, channel) + index
        out += section(11, statistics + struct.pack("<HQ", 1, 1))
    path.write_bytes(out + section(2, struct.pack("<QQI", start, 0, 0)) + MAGIC)


READS = """
import resource, sys
from pathlib import Path
from fnn_ekf_ros.recordings.bag_files import BagError, BagReader
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    with BagReader(Path(sys.argv[1])) as bag:
        for _ in bag.records():
            pass
except BagError as error:
    print(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def read_apart(path: Path) -> tuple[str, float]:
    """Read a recording in a process of its own; return what it says and the memory [MiB]."""
    ended = subprocess.run(
        [sys.executable, "-c", READS, str(path)], env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, timeout=60.0,
    )  # fmt: skip
    line, memory_kib = ended.stdout.splitlines()
    return line, int(memory_kib) / 1024.0


@pytest.mark.parametrize(
    ("compression", "declared", "indexed"),
    [("zstd", 2**30, True), ("zstd", 2**20, False), ("lz4", 2**20, True)],
)
@pytest.mark.slow
def test_a_chunk_is_not_unpacked_without_end(
    tmp_path: Path, compression: str, declared: int, indexed: bool
) -> None:
    path = tmp_path / "bomb.mcap"
    write_mcap(path, [(1, declared, zeros(compression, 2**30))], compression, indexed)
    line, memory = read_apart(path)
    assert line.startswith(f"bag '{path}' cannot be unpacked: ")
    assert "`mcap filter --chunk-size 4194304`" in line
    assert memory < 2.5 * LARGEST_CHUNK / 2**20


def test_many_chunks_at_once_are_too_much_and_one_after_the_other_are_not(tmp_path: Path) -> None:
    size = LARGEST_CHUNK // 2
    for name, apart in (("together.mcap", 0), ("apart.mcap", 10)):
        write_mcap(tmp_path / name, [(1 + apart * i, size, b"") for i in range(5)], "zstd")
    with BagReader(tmp_path / "apart.mcap") as bag:
        assert list(bag.topics) == ["/left_ticks"]
    with pytest.raises(BagError, match="chunks of the same time have more than 536870912 bytes"):
        BagReader(tmp_path / "together.mcap")


def declare_compressed(bag: Path, mode: str) -> None:
    """Say in the metadata that messages or files are compressed."""
    metadata = bag / "metadata.yaml"
    words = metadata.read_text().replace("compression_mode: ''", f"compression_mode: {mode}")
    metadata.write_text(words.replace("compression_format: ''", "compression_format: zstd"))


def test_a_compressed_file_is_not_unpacked_without_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whole files are unpacked on the disk, in a folder that does not stay."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "unpacked"))
    (tmp_path / "unpacked").mkdir()
    with BagWriter(tmp_path / "bag", "sqlite3") as bag:
        bag.write("/left_ticks", Message(messages.TICKS_TYPE, {"data": 1}), 1)
    file = tmp_path / "bag" / "bag.db3"
    zstd = mcap.zstd  # type: ignore[attr-defined]
    declare_compressed(tmp_path / "bag", "FILE")
    file.write_bytes(zstd.compress(file.read_bytes()))
    with BagReader(tmp_path / "bag") as read:
        assert len(list(read.records())) == 1
    monkeypatch.setattr(rosbags_api, "LARGEST_CHUNK", 2**20)
    file.write_bytes(zeros("zstd", 2**26))
    with pytest.raises(BagError, match=r"a compressed file has more than \d+ bytes"):
        BagReader(tmp_path / "bag")
    assert list((tmp_path / "unpacked").iterdir()) == []


def test_a_compressed_message_is_not_unpacked_without_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In sqlite3, messages are compressed one by one."""
    monkeypatch.setattr(rosbags_api, "LARGEST_CHUNK", 2**20)
    with BagWriter(tmp_path / "bag", "sqlite3") as bag:
        bag.write("/left_ticks", Message(messages.TICKS_TYPE, {"data": 1}), 1)
    with sqlite3.connect(tmp_path / "bag" / "bag.db3") as file:
        file.execute("UPDATE messages SET data = ?", (zeros("zstd", 2**24),))
    declare_compressed(tmp_path / "bag", "MESSAGE")
    with (
        BagReader(tmp_path / "bag") as read,
        pytest.raises(BagError, match="a chunk or a message has more than 1048576 bytes"),
    ):
        list(read.records())


def test_whole_frames_are_unpacked_whatever_their_number() -> None:
    zstd = mcap.zstd  # type: ignore[attr-defined]
    data = zstd.compress(b"one") + zstd.compress(b"") + zstd.compress(b"three")
    assert mcap.DECOMPRESSORS["zstd"](data, 8) == b"onethree"
    with pytest.raises(rosbags_api.TooLargeError):
        mcap.DECOMPRESSORS["zstd"](data, 7)
    with pytest.raises(EOFError):
        mcap.DECOMPRESSORS["zstd"](data[:-3], 8)


@pytest.mark.parametrize(
    ("name", "kind"), [("bag.mcap", "fifo"), ("metadata.yaml", "fifo"), ("another", "device")]
)
def test_nothing_waits_for_what_is_no_file(tmp_path: Path, name: str, kind: str) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/left_ticks", Message(messages.TICKS_TYPE, {"data": 1}), 1)
    path = tmp_path / "bag" / name
    path.unlink(missing_ok=True)
    if kind == "fifo":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    line, _ = read_apart(tmp_path / "bag")
    assert line.startswith(f"bag '{tmp_path / 'bag'}': '{name}' (")
    assert line.endswith(") is no file: expected a recording")


def late_copy(recorded: Path, out: Path) -> Path:
    """Write a recording again as if it had been made after 2038."""
    with BagReader(recorded) as bag, BagWriter(out) as late:
        for record in bag.records():
            late.write_raw(record._replace(time_ns=record.time_ns + LAST_STAMP_S * 10**9))
    return out


def test_times_after_2038_are_one_line(tmp_path: Path, recorded: Path, refuse: Refuse) -> None:
    late = late_copy(recorded, tmp_path / "late")
    given = ["--params", parameters_of(recorded)]
    line = refuse("replay", late, tmp_path / "out", *given)
    assert line.startswith(f"replay: bag '{late}' has messages of 21474836")
    assert "stamps of ROS end in 2038" in line
    assert "2038" in refuse(
        "compare", late, "--params", *given[1:], *given[1:], "--labels", "a", "b"
    )
    assert "2038" in refuse("tune", late, *given)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_stamp_that_cannot_be_written_is_one_line(tmp_path: Path, sign: int) -> None:
    late_ns = sign * (LAST_STAMP_S + 2) * 10**9
    message = messages.compass_message(late_ns, "base_link", 0.1, 0.2)
    with (
        pytest.raises(BagError, match=r"on /compass at -?2147483649.000 s .*end in 2038"),
        BagWriter(tmp_path / "bag") as bag,
    ):
        bag.write("/compass", message, late_ns)
    with (
        pytest.raises(BagError, match=r"on /left_ticks at 0.000 s cannot be written as std_msgs/"),
        BagWriter(tmp_path / "bag") as bag,
    ):
        bag.write("/left_ticks", Message(messages.TICKS_TYPE, {"data": 2**31}), 1)
    assert not list(tmp_path.iterdir())


def said_of(path: Path) -> str:
    with pytest.raises(BagError) as refused:
        BagReader(path)
    return str(refused.value)


def test_what_is_no_finished_recording_says_what_to_do(tmp_path: Path, recorded: Path) -> None:
    broken, whole = tmp_path / "my bag", tmp_path / "all" / "whole"
    shutil.copytree(recorded, broken)
    shutil.copytree(recorded, whole)
    file = broken / "recorded.mcap"
    file.write_bytes(file.read_bytes()[:2000])
    for path in (broken, file):
        assert f"'{file}' breaks off after 0.002 MB" in said_of(path)
        assert f"`mcap recover '{file}' -o recovered.mcap`" in said_of(path)
    (broken / "metadata.yaml").unlink()
    line = said_of(broken)
    assert f"`ros2 bag reindex '{broken}'` makes one, or give '{file}'" in line
    assert said_of(tmp_path / "all").endswith(f"it is no recording, but holds '{whole}'")


def test_another_file_is_no_recording(tmp_path: Path, recorded: Path) -> None:
    (tmp_path / "run.mcap.zstd").write_text("x")
    for path in (tmp_path / "run.mcap.zstd", recorded / "metadata.yaml"):
        assert said_of(path) == (
            f"bag '{path}' is no recording: expected the folder of a rosbag2 recording, or its "
            ".mcap or .db3 file"
        )


def test_a_recording_of_ros_1_is_recognized(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    for path in (tmp_path / "drive.bag", folder / "drive.bag"):
        path.write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
        out = path.with_suffix("")
        expected = f"`rosbags-convert --src {path} --dst {out}` makes one of ROS 2"
        assert expected in said_of(path)
    assert expected in said_of(folder)
    odd = tmp_path / "drive.mcap"
    shutil.copy(tmp_path / "drive.bag", odd)
    assert "is a recording of ROS 1" in said_of(odd)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            ["encoder_source:=joint_states", "right_joint:=wheel"],
            "/joint_states has no joint 'wheel', but left_wheel_joint, right_wheel_joint: "
            "-p right_joint:=NAME takes another",
        ),
        (["frame_id:=/map"], "-p frame_id:=map takes the fixes of /lrf_pose"),
    ],
)
@pytest.mark.parametrize("command", ["replay", "compare", "tune"])
def test_a_filter_that_does_not_start_says_what_would_start_it(
    tmp_path: Path, recorded: Path, refuse: Refuse, command: str, words: list[str], expected: str
) -> None:
    given: list[object] = ["--params", parameters_of(recorded)]
    if command == "compare":
        given += [parameters_of(recorded), "--labels", "a", "b"]
    if command == "replay":
        given.insert(0, tmp_path / "out")
    assignments = itertools.chain.from_iterable(("-p", word) for word in words)
    assert expected in refuse(command, recorded, *given, *assignments)


@pytest.mark.parametrize(
    ("frame", "expected"),
    [
        (
            "/map",
            "-p frame_id:=/map takes the fixes of /lrf_pose, but frames of ROS 2 begin with no",
        ),
        ("", "the fixes of /lrf_pose have no frame: expected 'map' in theirs"),
    ],
)
def test_fixes_in_no_frame_of_ros_2(
    tmp_path: Path, recorded: Path, refuse: Refuse, frame: str, expected: str
) -> None:
    odd = tmp_path / "odd"
    with BagReader(recorded) as bag, BagWriter(odd) as out:
        for record in bag.records():
            if record.topic == "/lrf_pose":
                message = bag.message(record)
                message.header.frame_id = frame
                out.rewrite(record, message)
            else:
                out.write_raw(record)
    given = ["--params", parameters_of(recorded)]
    assert expected in refuse("replay", odd, tmp_path / "out", *given)


def test_a_topic_without_messages_is_named(tmp_path: Path, recorded: Path, refuse: Refuse) -> None:
    silent = tmp_path / "silent"
    with BagReader(recorded) as bag, BagWriter(silent) as out:
        for topic in bag.topics.values():
            if topic.name != "/compass":
                out.add_topic(topic)
        for record in bag.records():
            if record.topic not in ("/compass", "/lrf_pose"):
                out.write_raw(record)
    line = refuse("replay", silent, tmp_path / "out", "--params", parameters_of(recorded))
    assert "no message on /lrf_pose: -r lrf_pose:=NAME takes another topic" in line
    assert "no message on /compass: -r compass:=NAME takes another topic, -p lrf_use_yaw" in line
