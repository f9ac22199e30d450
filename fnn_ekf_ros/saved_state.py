"""The file a localizer keeps its state in, to start from it again; YAML."""

import json
import math
import os
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.limits import LARGEST_POSE_STD, LARGEST_POSITION
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.file_locks import NO_LOCKS, lock
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import finite_number
from fnn_ekf_ros.pipeline.saved import SavedState
from fnn_ekf_ros.text_files import read_text, remove_partials, write_text
from fnn_ekf_ros.yaml_text import load_yaml

FORMAT_VERSION = 1
ROBOT = (
    "wheel_radius",
    "wheel_separation",
    "gear_ratio",
    "encoder_counts_per_revolution",
    "encoder_source",
    "period",
    "frame_id",
)
"""Parameters that a state is worth nothing without."""
_HEAD = """\
# State of a localizer of fnn_ekf_ros, which writes it anew once a minute (parameter state_file).
# Units: ns, m, rad; noise as variances, of 375 ms (forward, heading) and of x, y, compass yaw,
# laser yaw.
"""


class SavedStateError(FnnEkfError):
    """A file that no localizer can start from."""


class Found(NamedTuple):
    """What was found under the name of a state file.

    Attributes:
        state: the state; None if there is none to start from.
        saved_at: when it was written, as the file has it; empty if there is none.
        cut_off: a writer was killed while it wrote; what it left has been removed.
        refused: why a file that is there cannot be used; empty if it can or is not there.
    """

    state: SavedState | None
    saved_at: str
    cut_off: bool
    refused: str

    def in_words(self, path: Path) -> list[str]:
        """Return what somebody should know of it, one line each."""
        lines = []
        if self.cut_off:
            kept = f"the state there is from {self.saved_at}" if self.state else "there is no other"
            lines.append(f"the last write of state_file '{path}' was cut off; {kept}")
        if self.refused:
            lines.append(
                f"{self.refused}; it is not used, and kept as '{path.name}.broken' when the state "
                "is written"
            )
        return lines


class StateFile:
    """A localizer's state file.

    Args:
        parameters: of the localizer; `state_file` is set.
    """

    def __init__(self, parameters: LocalizerParameters) -> None:
        self._parameters = parameters
        self.path = Path(parameters.state_file)
        self._keep_what_is_there = False
        self._lock: int | None = None

    def claim(self) -> None:
        """Keep the file for this localizer until `release`, or until the process ends.

        Two would overwrite each other's state, and start from it elsewhere. The lock is a file
        beside it, `FILE.lock`, which stays: each write replaces the file itself.

        Raises:
            SavedStateError: another localizer has it, or no state could ever be written there.
        """
        self._check_place()
        path = self.path.with_name(f"{self.path.name}.lock")
        try:
            self._lock = lock(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC)
        except BlockingIOError:
            raise SavedStateError(
                f"parameter 'state_file' is '{self.path}', which another localizer uses: expected "
                "a file of its own for each"
            ) from None
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise SavedStateError(f"'{path}' cannot be locked: {error.strerror}") from None

    def release(self) -> None:
        """Leave the file to the next one."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def find(self) -> Found:
        """Return the state that is there, and tidy up after a writer that was killed.

        Raises:
            SavedStateError: no state could ever be written there.
        """
        self._check_place()
        cut_off = remove_partials(self.path) > 0
        if not self.path.exists():
            return Found(None, "", cut_off, "")
        try:
            state, saved_at = read_state(self.path, self._parameters)
        except SavedStateError as error:
            self._keep_what_is_there = True
            return Found(None, "", cut_off, str(error))
        return Found(state, saved_at, cut_off, "")

    def _check_place(self) -> None:
        folder = self.path.absolute().parent
        if not folder.is_dir() or not os.access(folder, os.W_OK) or self.path.is_dir():
            raise SavedStateError(
                f"parameter 'state_file' is '{self.path}': expected a file in a folder that is "
                "there and can be written to"
            )

    def write(self, state: SavedState, saved_at: datetime) -> None:
        """Write a state; a file that `find` refused is kept, as `NAME.broken`, the first one.

        Raises:
            FnnEkfError: the file cannot be written.
        """
        text = render_state(state, self._parameters, saved_at)
        if self._keep_what_is_there:
            broken = self.path.with_name(f"{self.path.name}.broken")
            try:
                if not os.path.lexists(broken):
                    self.path.replace(broken)
            except OSError as error:
                raise SavedStateError(f"'{broken}' cannot be written: {error.strerror}") from None
            self._keep_what_is_there = False
        write_text(self.path, text)


def age_in_words(state: SavedState, now_ns: int) -> str:
    """Return how old a pose is by ROS time now [ns]; another clock may be earlier."""
    if now_ns < state.stamp_ns:
        return f"its pose is of {state.stamp_ns * 1e-9:.0f} s, which this clock has not reached"
    return f"its pose is {(now_ns - state.stamp_ns) * 1e-9:.0f} s old"


def render_state(state: SavedState, parameters: LocalizerParameters, saved_at: datetime) -> str:
    """Return the text of a state file; its numbers read as the very same floats."""
    lines = [
        f"format_version: {FORMAT_VERSION}",
        f'saved_at: "{saved_at.isoformat(" ", "seconds")}"',
    ]
    lines += ["robot:"]
    lines += [f"  {name}: {json.dumps(getattr(parameters, name))}" for name in ROBOT]
    lines += [
        f"stamp_ns: {state.stamp_ns}",
        f"pose: {_shown(state.pose)}",
        "covariance:",
        *(f"  - {_shown(row)}" for row in state.covariance),
        f"process_noise: {_shown(state.process_noise)}",
        f"measurement_noise: {_shown(state.measurement_noise)}",  # last: a cut shows by its bracket
    ]
    return _HEAD + "\n".join(lines) + "\n"


def read_state(path: Path, parameters: LocalizerParameters) -> tuple[SavedState, str]:
    """Return the state in a file, and when it was written.

    Args:
        path: the file.
        parameters: of the localizer that is to start from it.

    Raises:
        SavedStateError: it cannot be read, is none or broken, or of another robot; or its noise is
            outside of the parameters' bounds.
    """
    label = f"state_file '{path}'"
    content = load_yaml(read_text(path, "state_file", SavedStateError), label, SavedStateError)
    if not isinstance(content, Mapping) or content.get("format_version") != FORMAT_VERSION:
        raise SavedStateError(f"{label} holds no state: expected format_version {FORMAT_VERSION}")
    robot = content.get("robot")
    for name in ROBOT:
        saved = robot.get(name) if isinstance(robot, Mapping) else None
        if saved != getattr(parameters, name):
            raise SavedStateError(
                f"{label} is of a robot with {name} {str(saved)[:40]}: expected "
                f"{getattr(parameters, name)}, as in the parameters"
            )
    stamp_ns = content.get("stamp_ns")
    if isinstance(stamp_ns, bool) or not isinstance(stamp_ns, int):
        raise SavedStateError(f"{label}: stamp_ns is {str(stamp_ns)[:40]}, expected a whole number")
    pose = _numbers(label, content, "pose", (3,))
    if not np.all(np.abs(pose) <= (LARGEST_POSITION, LARGEST_POSITION, math.pi)):
        raise SavedStateError(
            f"{label}: pose is {pose.tolist()}, expected x, y [m] and a yaw from -pi to pi [rad]"
        )
    covariance = _numbers(label, content, "covariance", (3, 3))
    if not _is_covariance(covariance):
        raise SavedStateError(
            f"{label}: covariance is {content['covariance']}, expected a symmetric, positive "
            "definite matrix"
        )
    p = parameters
    process = _noise(
        label, content, "process_noise", p.process_noise_std_min, p.process_noise_std_max
    )
    measurement = _noise(
        label, content, "measurement_noise",
        (*p.measurement_noise_std_min, p.measurement_noise_std_min[2]),
        (*p.measurement_noise_std_max, p.measurement_noise_std_max[2]),
    )  # fmt: skip
    return SavedState(stamp_ns, pose, covariance, process, measurement), str(
        content.get("saved_at")
    )


def _is_covariance(matrix: FloatArray) -> bool:
    """Return whether a finite `(3, 3)` is symmetric and positive definite, no pose quite lost."""
    std = np.sqrt(np.maximum(np.diagonal(matrix), 0.0))
    if not np.all((std > 0.0) & (std <= 1.001 * np.asarray(LARGEST_POSE_STD))):
        return False
    correlation = matrix / std[:, None] / std[None, :]
    return bool(
        np.array_equal(matrix, matrix.T)
        and np.all(np.abs(correlation) <= 1.0 + 1e-9)
        and np.linalg.eigvalsh(correlation)[0] > 0.0
    )


def _noise(
    label: str,
    content: Mapping[str, Any],
    key: str,
    smallest_std: tuple[float, ...],
    largest_std: tuple[float, ...],
) -> FloatArray:
    variances = _numbers(label, content, key, (len(smallest_std),))
    low, high = np.square(smallest_std), np.square(largest_std)
    if not np.all((variances >= low) & (variances <= high)):
        raise SavedStateError(
            f"{label}: {key} is {variances.tolist()}, expected variances within the bounds "
            f"{key}_std_min and {key}_std_max of the parameters"
        )
    return variances


def _numbers(
    label: str, content: Mapping[str, Any], key: str, shape: tuple[int, ...]
) -> FloatArray:
    """Return an entry as an array; in each of its numbers a finite one."""
    given = content.get(key)
    rows = given if len(shape) == 2 else [given]
    expected = " x ".join(map(str, shape))
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        raise SavedStateError(f"{label}: {key} is missing, expected {expected} numbers")
    numbers = [[finite_number(entry) for entry in row] for row in rows]
    if any(len(row) != shape[-1] or None in row for row in numbers) or len(rows) != (
        shape[0] if len(shape) == 2 else 1
    ):
        raise SavedStateError(
            f"{label}: {key} is {str(given)[:80]}, expected {expected} finite numbers"
        )
    return np.array(numbers, dtype=np.float64).reshape(shape)


def _shown(values: FloatArray) -> str:
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"
