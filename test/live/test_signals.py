"""Commands that are ended before they are done leave nothing behind."""

import signal
from collections.abc import Callable
from typing import Any

import pytest

pytestmark = pytest.mark.live


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
