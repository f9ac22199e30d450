"""Commands that are ended before they are done leave nothing behind."""

import re
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fnn_ekf_ros.bag_files import BagError, BagReader
from fnn_ekf_ros.cli import run_command

pytestmark = pytest.mark.live
CHUNK = 150_000
"""An MCAP file that is so large has a chunk of messages [bytes]; the next one is being made."""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_ended_command_leaves_nothing(
    processes: Any, patiently: Callable[..., None], number: int, code: int
) -> None:
    place = processes.folder / "place"
    place.mkdir()
    started = processes.start("simulate", place / "bag", "--duration", 100000)
    patiently(lambda: any(place.iterdir()), "the first file")
    started.send_signal(number)
    assert started.wait(timeout=60.0) == code
    assert "Traceback" not in processes.output(started)
    assert not list(place.iterdir())


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a whole bag, its parameters beside it."""
    folder = tmp_path_factory.mktemp("finished")
    assert run_command("simulate", [str(folder / "finished"), "--duration", "5"]) == 0
    return folder


def grown(place: Path, size: int) -> bool:
    files = [file for kind in ("mcap", "db3") for file in place.glob(f".bag.????????/*/*.{kind}")]
    return sum(file.stat().st_size for file in files) >= size


@pytest.mark.parametrize(
    ("storage", "size"), [("mcap", 0), ("mcap", CHUNK), ("sqlite3", 1), ("sqlite3", 120_000)]
)
def test_a_killed_command_leaves_what_the_next_one_clears_away(
    processes: Any,
    patiently: Callable[..., None],
    finished: Path,
    storage: str,
    size: int,
) -> None:
    """The kill that no process can answer, at several moments of the writing."""
    place = processes.folder / "place"
    shutil.copytree(finished, place)
    before = {file: file.read_bytes() for file in place.rglob("*") if file.is_file()}

    killed = processes.start("simulate", place / "bag", "--duration", 100000, "--storage", storage)
    other = processes.start("simulate", place / "bag.other", "--duration", 100000)
    patiently(lambda: any(place.glob(".bag.other.*")), "the other command")
    other.send_signal(signal.SIGSTOP)  # it lives, and leaves the machine to the one that writes
    patiently(lambda: any(place.glob(".bag.????????")) and grown(place, size), "the file to grow")
    killed.send_signal(signal.SIGKILL)
    assert killed.wait(timeout=60.0) == -signal.SIGKILL
    (left,) = place.glob(".bag.????????")
    assert not (place / "bag").exists()

    again = processes.run("simulate", place / "bag", "--duration", 5)
    assert again.returncode == 0
    (line,) = again.stderr.splitlines()
    assert re.fullmatch(
        rf"removed '{re.escape(str(left))}': \d+\.\d MB of '{re.escape(str(place / 'bag'))}', "
        "whose writer was killed before it was done",
        line,
    )
    assert float(line.split(": ")[1].split()[0]) >= round(0.9 * size / 1e6, 1)
    (others,) = place.glob(".bag.*")
    assert others.name.startswith(".bag.other."), "the work of a living command is not touched"
    other.send_signal(signal.SIGTERM)
    other.send_signal(signal.SIGCONT)
    assert other.wait(timeout=60.0) == 143
    assert {file: file.read_bytes() for file in before} == before
    expected = {"finished", "finished.yaml", "bag", "bag.yaml"}
    assert {entry.name for entry in place.iterdir()} == expected
    for name in ("finished", "bag"):
        with BagReader(place / name) as bag:
            assert sum(1 for _ in bag.records()) == bag.message_count > 100


def test_what_a_killed_command_has_left_is_no_bag(
    processes: Any, patiently: Callable[..., None]
) -> None:
    place = processes.folder / "place"
    place.mkdir()
    killed = processes.start("simulate", place / "bag", "--duration", 100000)
    patiently(lambda: grown(place, CHUNK), "the file to grow")
    killed.send_signal(signal.SIGKILL)
    killed.wait(timeout=60.0)
    (file,) = place.glob(".bag.????????/**/*.mcap")
    with pytest.raises(BagError) as caught:
        BagReader(file)
    assert re.fullmatch(
        rf"bag '{re.escape(str(file))}' cannot be read: it breaks off after \d+\.\d MB, its writer "
        "was ended too early; `mcap recover` writes what is complete into a new file",
        str(caught.value),
    )
    with pytest.raises(BagError, match=r"has no metadata\.yaml"):
        BagReader(file.parent)
