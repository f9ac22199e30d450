# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Locks that go with the process that holds them, however it ends and in whichever container."""

import errno
import fcntl
import os
from contextlib import ExitStack
from pathlib import Path

from fnn_ekf_ros.errors import FnnEkfError

NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL)
"""Errors of a file system that has no locks."""


def lock(path: Path, flags: int, taken: FnnEkfError) -> ExitStack:
    """Lock a file or folder, until the result is closed or the process ends.

    A file system without locks lets everybody have it. A link is not followed: it could lead to a
    file of somebody else, which would be made or locked.

    Args:
        path: what to lock.
        flags: with which to open it.
        taken: the error to raise if another process has the lock.

    Raises:
        FnnEkfError: another process has the lock.
        OSError: the file or folder cannot be opened, or is a symbolic link.
    """
    with ExitStack() as held:
        descriptor = os.open(path, flags | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        held.callback(os.close, descriptor)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise taken from None
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
        return held.pop_all()
