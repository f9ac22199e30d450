# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Joint adaptation at an instant: what is learned from its readings, and the forecasts' step."""

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray
from fnn_ekf_ros.core.bank import Bank
from fnn_ekf_ros.core.evidence import log_likelihood
from fnn_ekf_ros.core.instant import Instant
from fnn_ekf_ros.core.joint import Lesson, learn
from fnn_ekf_ros.core.joint_filters import FORECASTS, step_forecasts
from fnn_ekf_ros.core.joint_state import Learned, stepped
from fnn_ekf_ros.core.rows import Rows, rows_where
from fnn_ekf_ros.core.state import JOINT, FilterModel, FilterState


def learn_at(
    model: FilterModel,
    state: FilterState,
    instant: Instant,
    bank: Bank,
    teaches: BoolArray,
    scored: Rows,
    steps: BoolArray,
) -> tuple[FilterState, Learned | None]:
    """Learn from scored readings, and step the forecasts in the bank.

    Args:
        model: the filter.
        state: before the readings, of mode joint.
        instant: the readings.
        bank: all filters after the readings; its forecasts are replaced.
        teaches: `(4, *batch)` rows that the noise may be learned from.
        scored: rows that are scored.
        steps: `(*batch)` whether these are a step of the forecasts.
    """
    joint = state.joint
    assert joint is not None
    of_joint, ahead = bank.filters(JOINT), instant.predicted.filters(JOINT)
    of_joint.mean[:, FORECASTS] = ahead.mean[:, FORECASTS]
    of_joint.covariance[:, :, FORECASTS] = ahead.covariance[:, :, FORECASTS]
    taught = rows_where(teaches & scored.each)
    learned = None
    if taught.some.any():
        shown, which = instant.taken, JOINT
        if taught is not instant.rows and not np.array_equal(taught.each, instant.rows.each):
            shown, which = instant.corrected_by(taught.each, JOINT), slice(None)
        likelihood = log_likelihood(shown.nis[which], shown.determinant[which], taught.total)
        seen = instant.seen.filters(JOINT)
        lesson = Lesson(
            innovation=seen.innovation,
            variance=seen.variance,
            likelihood=likelihood,
            taught=taught,
            scored=scored,
            since_scored=state.pace.scored,
        )
        adaptation = model.adaptation
        sets = adaptation.networks.joint.sets
        settles = None if state.lasting is None else ~state.lasting.offset.unknown
        learned = learn(
            joint, sets, adaptation.bounds, lesson, learning=adaptation.learning, settles=settles
        )
        steps = steps & taught.some
        step_forecasts(of_joint, bank.filters(model.layout.newer_forecasts), steps)
        joint = stepped(learned.state, steps)
    control = np.where(scored.some, 0.0, joint.control_since_scored)
    return state._replace(joint=joint._replace(control_since_scored=control)), learned
