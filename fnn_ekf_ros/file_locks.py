"""Locks that go with the process that holds them, however it ends and in whichever container."""

import errno
import fcntl
import os
from pathlib import Path

NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL)
"""What a file system without locks answers."""


def lock(path: Path, flags: int) -> int:
    """Return the descriptor that holds the lock of a file or folder; closing it gives it back.

    Args:
        path: what to lock.
        flags: with which to open it.

    Raises:
        BlockingIOError: somebody else has it.
        OSError: it cannot be opened, or its file system has no locks.
    """
    descriptor = os.open(path, flags, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor
