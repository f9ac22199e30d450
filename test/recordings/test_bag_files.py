# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Recordings: there and back, whole or not at all, and broken ones in one line."""

import gc
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from fnn_ekf_ros import messages
from fnn_ekf_ros.messages import Message
from fnn_ekf_ros.recordings.bag_files import BagError, BagReader, Record
from fnn_ekf_ros.recordings.bag_writer import STORAGES, BagWriter
from fnn_ekf_ros.reports.results import result_folder

START_NS = 1_700_000_000_000_000_001


def sample(number: int) -> list[tuple[str, Message]]:
    """Return messages of all kinds that the package writes."""
    stamp = START_NS + number
    pose = np.array([0.1 * number, -2.0, 0.3])
    covariance = np.arange(36.0).reshape(6, 6) + number
    return [
        ("/left_ticks", Message(messages.TICKS_TYPE, {"data": number - 5})),
        ("/compass", messages.compass_message(stamp, "base_link", 0.1 * number, 0.2)),
        (
            "/lrf_pose",
            Message(
                messages.POSE_TYPE,
                {
                    "header": messages.header(stamp, "map"),
                    "pose": messages.pose_with_covariance(pose, covariance),
                },
            ),
        ),
        (
            "/odom",
            messages.odometry_message(
                stamp, "map", "base_link", pose, np.array([0.3, -0.1]), covariance, covariance
            ),
        ),
        (
            "/joint_states",
            Message(
                messages.JOINT_STATES_TYPE,
                {
                    "header": messages.header(stamp, ""), "name": ["l", "räder"],
                    "position": np.array([1.5, -2.5]), "velocity": np.zeros(0),
                    "effort": np.zeros(0),
                },
            ),
        ),
    ]  # fmt: skip


def write_bag(path: Path, storage: str = "mcap", count: int = 20) -> None:
    with BagWriter(path, storage, {"note": "made by a test"}) as bag:
        for number in range(count):
            for topic, message in sample(number):
                bag.write(topic, message, START_NS + number * 10**7)


def read_bag(path: Path) -> list[Record]:
    with BagReader(path) as bag:
        return list(bag.records())


def read_all(path: Path) -> None:
    with BagReader(path) as bag:
        for record in bag.records():
            bag.message(record)


def refusal(path: Path) -> str:
    """Read a whole bag that must be refused; returns the one line."""
    with pytest.raises(BagError) as caught:
        read_all(path)
    line = str(caught.value)
    assert "\n" not in line
    assert str(path) in line
    return line


@pytest.fixture(params=STORAGES)
def storage(request: pytest.FixtureRequest) -> str:
    """Each storage."""
    return str(request.param)


def same(read: Any, written: Any) -> bool:
    """Return whether a message of rosbags holds what a tree holds."""
    if isinstance(written, Message):
        return all(same(getattr(read, name), value) for name, value in written.fields.items())
    if isinstance(written, np.ndarray):
        return bool(np.array_equal(read, written))
    return bool(read == written)


def test_what_is_written_is_read(tmp_path: Path, storage: str) -> None:
    write_bag(tmp_path / "bag", storage)
    with BagReader(tmp_path / "bag") as bag:
        assert bag.message_count == 100
        assert bag.start_ns == START_NS
        assert bag.duration_s == pytest.approx(0.19)
        assert {name: (t.type_name, t.message_count) for name, t in bag.topics.items()} == {
            topic: (message.type_name, 20) for topic, message in sample(0)
        }
        expected = [
            (topic, message, START_NS + number * 10**7)
            for number in range(20)
            for topic, message in sample(number)
        ]
        for record, (topic, message, time_ns) in zip(bag.records(), expected, strict=True):
            assert (record.topic, record.type_name) == (topic, message.type_name)
            assert record.time_ns == time_ns
            assert same(bag.message(record), message)


def test_topics_can_be_chosen(tmp_path: Path, storage: str) -> None:
    write_bag(tmp_path / "bag", storage)
    with BagReader(tmp_path / "bag") as bag:
        chosen = list(bag.records({"/odom", "/compass", "/missing"}))
        assert {record.topic for record in chosen} == {"/odom", "/compass"}
        assert len(chosen) == 40
        assert [r.time_ns for r in chosen] == sorted(r.time_ns for r in chosen)
        assert list(bag.records(set())) == []


def test_a_raw_copy_keeps_every_byte_and_profile(tmp_path: Path, storage: str) -> None:
    write_bag(tmp_path / "bag", storage)
    with BagReader(tmp_path / "bag") as bag:
        topics = dict(bag.topics)
        with BagWriter(tmp_path / "copy", storage) as out:
            for topic in topics.values():
                out.add_topic(topic)
            for record in bag.records():
                out.write_raw(record)
    assert read_bag(tmp_path / "copy") == read_bag(tmp_path / "bag")
    with BagReader(tmp_path / "copy") as copy:
        assert dict(copy.topics) == topics
        assert all(topic.reliable and not topic.transient_local for topic in topics.values())


def test_topics_without_messages_are_kept(tmp_path: Path, storage: str) -> None:
    write_bag(tmp_path / "bag", storage, 1)
    with BagReader(tmp_path / "bag") as bag, BagWriter(tmp_path / "copy", storage) as out:
        for topic in bag.topics.values():
            out.add_topic(topic)
    with BagReader(tmp_path / "copy") as copy:
        assert {t.name: t.message_count for t in copy.topics.values()} == dict.fromkeys(
            [topic for topic, _ in sample(0)], 0
        )
        assert list(copy.records()) == []


def test_the_same_messages_make_the_same_bytes(tmp_path: Path, storage: str) -> None:
    contents = []
    for folder in (tmp_path / "one", tmp_path / "two"):
        folder.mkdir()
        write_bag(folder / "bag", storage)
        files = sorted((folder / "bag").iterdir())
        contents.append({file.name: file.read_bytes() for file in files})
        assert sorted(path.name for path in folder.iterdir()) == ["bag"]
    assert contents[0] == contents[1]


def test_the_bag_appears_when_it_is_complete(tmp_path: Path, storage: str) -> None:
    path = tmp_path / "bag"
    with BagWriter(path, storage) as bag:
        bag.write(*sample(0)[0], START_NS)
        assert not path.exists()
    assert len(read_bag(path)) == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["bag"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, BagError])
def test_an_error_leaves_nothing(tmp_path: Path, storage: str, error: type[BaseException]) -> None:
    def break_off() -> None:
        with BagWriter(tmp_path / "bag", storage) as bag:
            for topic, message in sample(0):
                bag.write(topic, message, START_NS)
            raise error("on the way")

    with pytest.raises(error):
        break_off()
    assert list(tmp_path.iterdir()) == []


def interrupt_after_mkdir(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a signal come as soon as a folder is there."""
    mkdir = Path.mkdir

    def interrupted(path: Path, *words: Any, **options: Any) -> None:
        mkdir(path, *words, **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "mkdir", interrupted)


def test_a_signal_in_the_first_moment_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupt_after_mkdir(monkeypatch)
    with pytest.raises(KeyboardInterrupt), BagWriter(tmp_path / "bag"):
        pass
    with pytest.raises(KeyboardInterrupt), result_folder(tmp_path / "out"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_an_existing_path_is_refused_and_left_alone(tmp_path: Path, storage: str) -> None:
    file, folder = tmp_path / "file", tmp_path / "folder"
    file.write_text("mine")
    folder.mkdir()
    (folder / "mine").write_text("mine")
    for path in (file, folder):
        with pytest.raises(BagError, match="exists already"):
            BagWriter(path, storage)
    assert file.read_text() == (folder / "mine").read_text() == "mine"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "folder"]


def test_a_path_that_is_taken_meanwhile_is_left_alone(tmp_path: Path, storage: str) -> None:
    path = tmp_path / "bag"

    def be_late() -> None:
        with BagWriter(path, storage) as bag:
            bag.write(*sample(0)[0], START_NS)
            path.mkdir()
            (path / "mine").write_text("mine")

    with pytest.raises(BagError, match="exists already"):
        be_late()
    assert [entry.name for entry in tmp_path.iterdir()] == ["bag"]
    assert [entry.name for entry in path.iterdir()] == ["mine"]


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"folder '.*nowhere' does not exist"):
        BagWriter(tmp_path / "nowhere" / "bag")
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="does not exist"):
        BagWriter(tmp_path / "file" / "bag")


def test_a_name_that_cannot_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError):
        BagWriter(tmp_path / ("x" * 300))


def test_single_files_can_be_read(tmp_path: Path, storage: str) -> None:
    write_bag(tmp_path / "bag", storage)
    (file,) = (p for p in (tmp_path / "bag").iterdir() if p.suffix in (".mcap", ".db3"))
    assert read_bag(file) == read_bag(tmp_path / "bag")


def test_what_is_not_there_or_no_bag_is_refused_in_one_line(tmp_path: Path) -> None:
    assert "does not exist" in refusal(tmp_path / "missing")
    (tmp_path / "folder").mkdir()
    assert "has no metadata.yaml" in refusal(tmp_path / "folder")
    for name, content in (
        ("empty.mcap", b""), ("empty.db3", b""), ("words.mcap", b"no bag at all, just words" * 9),
        ("words.db3", b"no bag at all, just words" * 9), ("words.txt", b"words"), ("words", b""),
    ):  # fmt: skip
        (tmp_path / name).write_bytes(content)
        refusal(tmp_path / name)


@pytest.mark.parametrize(
    "metadata", ["", "words", "a: [1", "rosbag2_bagfile_information: {}", "\x00", "- 1\n- 2\n"]
)
def test_broken_metadata_is_refused_in_one_line(tmp_path: Path, metadata: str) -> None:
    write_bag(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").write_text(metadata)
    refusal(tmp_path / "bag")


def test_a_bag_without_its_file_is_refused_in_one_line(tmp_path: Path, storage: str) -> None:
    write_bag(tmp_path / "bag", storage)
    next(p for p in (tmp_path / "bag").iterdir() if p.suffix in (".mcap", ".db3")).unlink()
    refusal(tmp_path / "bag")


@pytest.mark.parametrize("part", [0.0, 0.001, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 0.999])
@pytest.mark.slow
def test_truncated_bags_are_refused_in_one_line(tmp_path: Path, storage: str, part: float) -> None:
    write_bag(tmp_path / "bag", storage)
    file = next(p for p in (tmp_path / "bag").iterdir() if p.suffix in (".mcap", ".db3"))
    content = file.read_bytes()
    file.write_bytes(content[: int(part * len(content))])
    if storage == "sqlite3" and part > 0.99:  # only the unused end of the last page is gone
        assert len(read_bag(file)) == 100
        return
    refusal(tmp_path / "bag")
    refusal(file)


@pytest.mark.slow
def test_damaged_bags_raise_nothing_but_bag_errors(tmp_path: Path, storage: str) -> None:
    write_bag(tmp_path / "bag", storage)
    file = next(p for p in (tmp_path / "bag").iterdir() if p.suffix in (".mcap", ".db3"))
    content = file.read_bytes()
    refused = 0
    for index in range(30):
        place = math.floor((index + 0.5) / 30 * len(content))
        file.write_bytes(content[:place] + bytes(b ^ 0xFF for b in content[place : place + 8])
                         + content[place + 8 :])  # fmt: skip
        try:
            read_all(tmp_path / "bag")
        except BagError as error:
            refused += 1
            lines = str(error).count("\n")
        else:
            lines = 0
        assert lines == 0
    assert refused > 0


@pytest.mark.slow
def test_damaged_messages_are_refused_in_one_line(tmp_path: Path, storage: str) -> None:
    for cut in (0, 3, 4, 20, 100):
        path = tmp_path / f"bag{cut}"
        write_bag(tmp_path / f"whole{cut}", storage, 1)
        with BagWriter(path, storage) as out:
            for record in read_bag(tmp_path / f"whole{cut}"):
                out.write_raw(record._replace(data=record.data[:cut]))
        if cut < 100:
            assert "cannot be read as" in refusal(path)


def write_two_types(path: Path, storage: str) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        bag.add_connection("/topic", "std_msgs/msg/Int32", typestore=store)
        bag.add_connection("/topic", "std_msgs/msg/Int64", typestore=store)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_topic_of_two_types_is_refused(tmp_path: Path, storage: str) -> None:
    write_two_types(tmp_path / "bag", storage)
    assert "has two types" in refusal(tmp_path / "bag")
    gc.collect()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_refused_recording_is_closed(tmp_path: Path) -> None:
    write_two_types(tmp_path / "bag", "mcap")
    with pytest.raises(BagError) as caught:
        BagReader(tmp_path / "bag")
    links = [link for link in Path("/proc/self/fd").iterdir() if link.is_symlink()]
    still_open = [link.readlink() for link in links]
    del caught
    gc.collect()
    assert not [file for file in still_open if file.is_relative_to(tmp_path)]


def test_notes_are_kept_in_the_metadata(tmp_path: Path, storage: str) -> None:
    write_bag(tmp_path / "bag", storage)
    assert "made by a test" in (tmp_path / "bag" / "metadata.yaml").read_text()


def test_times_out_of_order_come_back_in_order(tmp_path: Path, storage: str) -> None:
    times = [START_NS + offset for offset in (5, 3, 9, 1, 7)]
    with BagWriter(tmp_path / "bag", storage) as bag:
        for time_ns in times:
            bag.write(*sample(0)[0], time_ns)
    assert [record.time_ns for record in read_bag(tmp_path / "bag")] == sorted(times)


def test_a_read_only_copy_of_a_real_command(recorded: Path) -> None:
    """What the package simulates is what its reader calls the localizer's inputs."""
    with BagReader(recorded) as bag:
        types = {name: topic.type_name for name, topic in bag.topics.items()}
    for topic in ("left_ticks", "right_ticks", "joint_states", "compass", "lrf_pose"):
        assert types[f"/{topic}"] == messages.INPUT_TYPES[topic]
