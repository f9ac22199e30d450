# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The end of a script: its exit code, and one line for an error."""

import sys
from collections.abc import Callable

from fnn_ekf_ros.errors import FnnEkfError, in_one_line
from fnn_ekf_ros.stopping import FAILURE, INTERRUPTED


def exit_code(name: str, work: Callable[[], None], interrupted: str) -> int:
    """Do the work of a script; return its exit code.

    Args:
        name: of the script, before an error.
        work: what the script does.
        interrupted: what to print if SIGINT ends it.
    """
    try:
        work()
    except FnnEkfError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return FAILURE
    except OSError as error:
        print(f"{name}: {in_one_line(error)}", file=sys.stderr)
        return FAILURE
    except KeyboardInterrupt:
        print(f"{name}: interrupted, {interrupted}", file=sys.stderr)
        return INTERRUPTED
    return 0
