# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The file a localizer keeps its state in, to start from it again; YAML."""

import errno
import json
import math
import os
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.lasting.members import HORIZONS_S, MEMBER_COUNT
from fnn_ekf_ros.core.limits import LARGEST_POSE_STD, LARGEST_POSITION
from fnn_ekf_ros.errors import FnnEkfError, reason_of
from fnn_ekf_ros.files.fields import Fields
from fnn_ekf_ros.files.locks import lock
from fnn_ekf_ros.files.text_files import remove_partials, write_text
from fnn_ekf_ros.files.yaml_text import read_yaml
from fnn_ekf_ros.localizer.saved_state import SavedState
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.filter_model import noise_bounds

FORMAT_VERSION = 1
"""Version of the file's layout: a file of another one is refused."""
_IN_EVERY_FILE = (
    "wheel_radius",
    "wheel_separation",
    "gear_ratio",
    "encoder_counts_per_revolution",
    "encoder_source",
    "period",
    "frame_id",
)
"""Those of `ROBOT` that the first files had; a file without one of the others is not compared with
it."""
ROBOT = (
    *_IN_EVERY_FILE,
    "encoder_bits",
    "left_inverted",
    "right_inverted",
    "left_wheel_radius_multiplier",
    "right_wheel_radius_multiplier",
    "left_joint",
    "right_joint",
    "lrf_use_message_covariance",
    "lrf_yaw_offset",
    "lrf_pose_scale",
    "lrf_pose_delay",
    "compass_clockwise",
    "compass_offset",
    "compass_delay",
)
"""Parameters in which a saved state and the localizer have to agree: all that say what a message
means. With another value the noise and the weights of lasting errors were learned of other
readings: those of a wrong offset, scale, delay or wheel include its error. Parameters that only
say where the filter starts, how it adapts, what it takes for an outlier or how long it waits leave
the state what it is."""
_HEAD = """\
# State of a localizer of fnn_ekf_ros, which writes it anew once a minute (parameter state_file).
# Units: ns, m, rad; noise as variances, of 375 ms (distance, rotation) and of x, y, compass yaw,
# laser yaw; log weights of hypotheses about lasting errors, by duration of simulated outages.
"""
"""Comment at the top of a file."""


_WEIGHTS = "lasting_log_weight"
"""Key of the members' log weights; a file of a localizer that does not follow lasting errors, or of
an older version, has none."""
_SMALLEST_LOG_WEIGHT = -100.0
"""Smallest log weight that is read [nats]: redrawing keeps those of a localizer far above it."""


class SavedStateError(FnnEkfError):
    """A file that no localizer can start from."""


class ReadState(NamedTuple):
    """The state that a file holds.

    Attributes:
        state: the state.
        saved_at: when it was written, as the file has it.
    """

    state: SavedState
    saved_at: str


class Found(NamedTuple):
    """The content of a state file.

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
        """Return the warnings about it, one line each."""
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
        self._lock = ExitStack()

    def claim(self) -> None:
        """Keep the file for this localizer until `release`, or until the process ends.

        Two would overwrite each other's state, and start from it elsewhere. The lock is a file
        beside it, `FILE.lock`, which stays: each write replaces the file itself.

        Raises:
            SavedStateError: another localizer has it, or no state could ever be written there.
        """
        self._check_place()
        path = self.path.with_name(f"{self.path.name}.lock")
        taken = SavedStateError(
            f"parameter 'state_file' is '{self.path}', which another localizer uses: expected "
            "a file of its own for each"
        )
        try:
            self._lock = lock(path, os.O_RDWR | os.O_CREAT, taken)
        except OSError as error:
            reason = reason_of(error)
            if error.errno == errno.ELOOP:
                reason = "it is a symbolic link, expected a file or nothing; remove it"
            raise SavedStateError(f"'{path}' cannot be locked: {reason}") from None

    def release(self) -> None:
        """Leave the file to the next one."""
        self._lock.close()

    def find(self) -> Found:
        """Return the state in the file, and remove what a writer that was killed has left.

        Raises:
            SavedStateError: no state could ever be written there.
        """
        self._check_place()
        cut_off = remove_partials(self.path) > 0
        if not self.path.exists():
            return Found(state=None, saved_at="", cut_off=cut_off, refused="")
        try:
            read = read_state(self.path, self._parameters)
        except SavedStateError as error:
            self._keep_what_is_there = True
            return Found(state=None, saved_at="", cut_off=cut_off, refused=str(error))
        return Found(state=read.state, saved_at=read.saved_at, cut_off=cut_off, refused="")

    def _check_place(self) -> None:
        folder = self.path.absolute().parent
        if not folder.is_dir() or not os.access(folder, os.W_OK) or self.path.is_dir():
            raise SavedStateError(
                f"parameter 'state_file' is '{self.path}': expected a file in a folder that is "
                "there and can be written to"
            )

    def write(self, state: SavedState, saved_at: datetime) -> None:
        """Write a state; a file that `find` refused is kept, as `NAME.broken`, the first one.

        Noise that has left the bounds of the parameters, because they were changed at run time, is
        written as the bound: the next start has these parameters again.

        Raises:
            FnnEkfError: the file cannot be written.
        """
        process, measurement = noise_bounds(self._parameters).within(
            state.process_noise, state.measurement_noise
        )
        state = state._replace(process_noise=process, measurement_noise=measurement)
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
    # Not in ASCII: JSON writes two escapes for some characters, which YAML reads as two.
    lines += [
        f"  {name}: {json.dumps(getattr(parameters, name), ensure_ascii=False)}" for name in ROBOT
    ]
    lines += [
        f"stamp_ns: {state.stamp_ns}",
        f"pose: {_shown(state.pose)}",
        "covariance:",
        *(f"  - {_shown(row)}" for row in state.covariance),
        f"process_noise: {_shown(state.process_noise)}",
    ]
    if state.log_weight is not None:
        lines += [f"{_WEIGHTS}:", *(f"  - {_shown(row)}" for row in state.log_weight)]
    lines += [
        f"measurement_noise: {_shown(state.measurement_noise)}",  # last: a cut shows by its bracket
    ]
    return _HEAD + "\n".join(lines) + "\n"


def read_state(path: Path, parameters: LocalizerParameters) -> ReadState:
    """Return the state in a file, and when it was written.

    Args:
        path: the file.
        parameters: of the localizer that is to start from it.

    Raises:
        SavedStateError: it cannot be read, is none or broken, or of another robot; or its noise is
            outside of the parameters' bounds.
    """
    fields = Fields(read_yaml(path, "state_file", SavedStateError), f"state_file '{path}'",
                    SavedStateError, "the state of a localizer")  # fmt: skip
    fields.version("format_version", FORMAT_VERSION)
    robot = fields.section("robot", "the parameters of the robot")
    for name in ROBOT:
        compared = name in robot or name in _IN_EVERY_FILE
        if compared and robot.value(name) != getattr(parameters, name):
            raise robot.refusal(name, f"{getattr(parameters, name)}, as in the parameters")
    stamp_ns = fields.whole("stamp_ns")
    pose = np.array(fields.numbers("pose", 3))
    if not np.all(np.abs(pose) <= (LARGEST_POSITION, LARGEST_POSITION, math.pi)):
        raise fields.refusal("pose", "x, y [m] and a yaw from -pi to pi [rad]")
    covariance = np.array(fields.matrix("covariance", 3, 3))
    if not _is_covariance(covariance):
        raise fields.refusal("covariance", "a symmetric, positive definite matrix")
    bounds = noise_bounds(parameters)
    process = _noise(fields, "process_noise", bounds.process_min, bounds.process_max)
    measurement = _noise(
        fields, "measurement_noise", bounds.measurement_min, bounds.measurement_max
    )
    state = SavedState(
        stamp_ns=stamp_ns,
        pose=pose,
        covariance=covariance,
        process_noise=process,
        measurement_noise=measurement,
        log_weight=_log_weight(fields) if _WEIGHTS in fields else None,
    )
    return ReadState(state=state, saved_at=str(fields.value("saved_at")))


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
    fields: Fields, key: str, smallest: tuple[float, ...], largest: tuple[float, ...]
) -> FloatArray:
    variances = np.array(fields.numbers(key, len(smallest)))
    if not np.all((variances >= smallest) & (variances <= largest)):
        raise fields.refusal(
            key, f"variances within the bounds {key}_std_min and {key}_std_max of the parameters"
        )
    return variances


def _log_weight(fields: Fields) -> FloatArray:
    log_weight = np.array(fields.matrix(_WEIGHTS, len(HORIZONS_S), MEMBER_COUNT))
    if not (
        np.all(log_weight >= _SMALLEST_LOG_WEIGHT)
        and np.allclose(np.exp(np.minimum(log_weight, 1.0)).sum(axis=1), 1.0)
    ):
        raise fields.refusal(_WEIGHTS, "logarithms of weights whose sum is 1 in each list")
    return log_weight


def _shown(values: FloatArray) -> str:
    return "[" + ", ".join(repr(float(value)) for value in values) + "]"
