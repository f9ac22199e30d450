# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What filters of `study real` start with because another recording taught it.

A start does what a warm start does, without the saved pose: the noise that was learned takes the
place of the configured one, and the weights of the hypotheses about lasting errors that of the
prior. A state file holds these once, for every start. Of a recording every filter learns from each
of the starts by itself, so that a start which was wrong there goes on with what it has become.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.state import FilterState
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.localizer.history import LearnedState, learned_by
from fnn_ekf_ros.localizer.saved_state import SavedState
from fnn_ekf_ros.localizer.state_file import ROBOT, read_state
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.study.ablations import real_filters
from fnn_ekf_ros.study.real import BatchStart, run_starts
from fnn_ekf_ros.study.starts import ALL_CELLS


class Teacher(NamedTuple):
    """A state file or a recording that filters learn from.

    Attributes:
        label: its name.
        parameters: of the localizer that it was recorded for.
        source: the state in the file; or starts and periods of the recording.
    """

    label: str
    parameters: LocalizerParameters
    source: SavedState | BatchStart


def teacher_from_file(path: Path, parameters: LocalizerParameters) -> Teacher:
    """Return the state file of a robot as a teacher.

    Raises:
        SavedStateError: the file cannot be used.
    """
    return Teacher(path.name, parameters, read_state(path, parameters).state)


def check_same_robot(teacher: Teacher, label: str, parameters: LocalizerParameters) -> None:
    """Check that a teacher is of the robot of a recording, as for a warm start.

    Args:
        teacher: the teacher.
        label: of the recording.
        parameters: of the recording.

    Raises:
        FnnEkfError: they differ in a parameter that belongs to the robot.
    """
    for name in ROBOT:
        of_teacher, own = getattr(teacher.parameters, name), getattr(parameters, name)
        if of_teacher != own:
            raise FnnEkfError(
                f"'{teacher.label}' has {name} {of_teacher}: expected {own}, as of '{label}'"
            )


def taught_by(teacher: Teacher, name: str) -> LearnedState:
    """Return what every start of a filter begins with, each with a last axis of the starts.

    Args:
        teacher: the teacher.
        name: of the filter.

    Raises:
        FnnEkfError: the filter failed on the teacher's recording.
    """
    if isinstance(teacher.source, SavedState):
        saved = teacher.source
        return LearnedState(
            _of_all_starts(saved.process_noise),
            _of_all_starts(saved.measurement_noise),
            None if saved.log_weight is None else _of_all_starts(saved.log_weight),
        )
    which, last = real_filters(teacher.parameters)[name], None
    states = run_starts(which.model, teacher.source, which.hold)
    try:
        total = 1 + len(teacher.source.inputs)
        for state in with_progress(states, total, f"{teacher.label}: {name} learns"):
            last = state
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise FnnEkfError(f"'{teacher.label}': the filter {name} failed ({error})") from None
    assert isinstance(last, FilterState)
    return learned_by(which.model, last)


def _of_all_starts(values: FloatArray) -> FloatArray:
    return np.broadcast_to(values[..., None], (*values.shape, len(ALL_CELLS)))
