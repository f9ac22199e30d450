"""Hidden folders in which results grow until they are complete; nobody's are cleared away.

A process that is killed (SIGKILL, power) cannot tidy up. So each folder is locked by whoever writes
in it: the lock goes with the process, however it ends and in whichever container it ran, and the
next one that makes the same result finds a folder without a lock.
"""

import logging
import os
import re
import secrets
import shutil
from contextlib import suppress
from pathlib import Path

from fnn_ekf_ros.file_locks import NO_LOCKS, lock

_LOG = logging.getLogger(__name__)
"""Unless the program says otherwise, its warnings go to stderr as they are."""


class WorkFolder:
    """A hidden folder beside the place of a result, `.NAME.xxxxxxxx`.

    Args:
        result: where the result will be.

    Attributes:
        path: the folder.
    """

    def __init__(self, result: Path) -> None:
        self._result = result
        # Named before it is made, so that no signal in between can leave it behind.
        self.path = result.with_name(f".{result.name}.{secrets.token_hex(4)}")
        self._lock: int | None = None

    def make(self) -> None:
        """Make it, and clear away those of writers of the same result that were killed.

        Raises:
            OSError: it cannot be made.
        """
        self._clear_away_nobodys()
        while True:
            self.path.mkdir()
            with suppress(FileNotFoundError, BlockingIOError):
                try:
                    self._lock = _lock(self.path)
                except OSError as error:
                    if error.errno not in NO_LOCKS:
                        raise  # without locks nobody's folders stay
                if self.path.exists():
                    return
            self.remove()  # somebody took it for nobody's before it was locked

    def remove(self) -> None:
        """Remove it with all that is in it."""
        shutil.rmtree(self.path, ignore_errors=True)
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _clear_away_nobodys(self) -> None:
        pattern = re.compile(rf"\.{re.escape(self._result.name)}\.[0-9a-f]{{8}}")
        own = {self._result.name, f"{self._result.name}.yaml"}
        for folder in sorted(self._result.absolute().parent.iterdir()):
            if not pattern.fullmatch(folder.name) or not folder.is_dir() or folder.is_symlink():
                continue
            if not {entry.name for entry in folder.iterdir()} <= own:
                continue
            try:
                held = _lock(folder)
            except OSError:
                continue  # somebody is writing in it, or it is just going
            size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
            shutil.rmtree(folder, ignore_errors=True)
            os.close(held)
            _LOG.warning(
                "removed '%s': %.1f MB of '%s', whose writer was killed before it was done",
                folder, size / 1e6, self._result,
            )  # fmt: skip


def _lock(folder: Path) -> int:
    """Return the descriptor that holds a folder's lock.

    Raises:
        BlockingIOError: somebody else has it.
        OSError: the folder is not there, or its file system has no locks.
    """
    return lock(folder, os.O_RDONLY | os.O_DIRECTORY)
