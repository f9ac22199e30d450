# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What processes of `study.workers` do in its tests; a module that they can import."""

import os
import signal
from collections.abc import Callable


def adding(number: int) -> Callable[[object], object]:
    """Return what adds a number, or comes to harm."""

    def serve(request: object) -> object:
        if request == "bug":
            raise ZeroDivisionError("one line\nand another")
        if request == "memory":
            raise MemoryError
        if request == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if request == "state":
            return signal.getsignal(signal.SIGINT), os.environ["OPENBLAS_NUM_THREADS"]
        assert isinstance(request, int)
        return number + request

    return serve
