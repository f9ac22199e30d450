# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The localizer's state file, as the node reads and writes it."""

from collections.abc import Callable
from datetime import UTC, datetime

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.localizer.saved_state import SavedState
from fnn_ekf_ros.localizer.state_file import StateFile, age_in_words
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import NO_FILE

from rclpy.clock import Clock, ClockType  # isort: skip
from rclpy.node import Node  # isort: skip

WRITE_INTERVAL_S = 60.0
"""Interval at which the state is written, in steady time [s]: a crash costs at most that much."""


class StateKeeper:
    """Keeps a localizer's state in its `state_file`; without one it does nothing.

    Args:
        node: its logger gets the warnings.
        parameters: of the localizer.

    Attributes:
        warm_start: the state to start from, if the parameters ask for it and it can be read.

    Raises:
        FnnEkfError: nothing can be written there, or another localizer writes there.
    """

    def __init__(self, node: Node, parameters: LocalizerParameters) -> None:
        self._node = node
        self._file: StateFile | None = None
        self.warm_start: SavedState | None = None
        if parameters.state_file == NO_FILE:
            return
        self._file = StateFile(parameters)
        self._file.claim()
        found = self._file.find()
        for line in found.in_words(self._file.path):
            node.get_logger().warning(line)
        if parameters.warm_start:
            self.warm_start = found.state
            node.get_logger().info(
                f"starting from the state of {found.saved_at} in '{self._file.path}'; "
                + age_in_words(found.state, int(node.get_clock().now().nanoseconds))
                if found.state is not None
                else f"starting without a state: '{self._file.path}' has none"
            )

    def write_regularly(self, state_now: Callable[[], SavedState | None]) -> None:
        """Write the state that a function returns, from now on."""
        if self._file is not None:
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self._node.create_timer(WRITE_INTERVAL_S, lambda: self.write(state_now()), clock=steady)

    def close(self) -> None:
        """Leave the file to the next one."""
        if self._file is not None:
            self._file.release()

    def write(self, state: SavedState | None) -> None:
        """Write a state, if there is one; what goes wrong is logged."""
        if self._file is None or state is None:
            return
        try:
            self._file.write(state, datetime.now(UTC))
        except FnnEkfError as error:
            self._node.get_logger().error(f"the state is not kept: {error}")
