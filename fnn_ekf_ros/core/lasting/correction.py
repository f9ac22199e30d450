# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Correction of the filters of lasting errors, with a bounded influence of outliers.

The noise of a fix is larger the worse it fits (Huber 1964). With e the NIS of its x and y, and h
the limit of the filter,

    R_k = R + (max(1, e / h) - 1) (R + P_bb),     R_yaw likewise without P_bb

h is 2 for all filters but the white one, whose limit is 9.21 unless outliers are frequent: a member
that explains large errors by lasting ones must not follow a single one. While the wheels stand they
may be silent, and the white member, which then follows the fixes, bounds nothing.
"""

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import STATE_SIZE, BoolArray, FloatArray, Row
from fnn_ekf_ros.core.bank import Bank, Coupling, Noise
from fnn_ekf_ros.core.lasting.augmented import Component
from fnn_ekf_ros.core.lasting.comparison import Comparison, Correcting
from fnn_ekf_ros.core.lasting.members import (
    ADVOCATE,
    COPIES,
    CORRECTED,
    FILTER_COUNT,
    WHITE,
    WITNESSES,
)
from fnn_ekf_ros.core.row_update import Terms, take_row
from fnn_ekf_ros.core.rows import in_order

LIMIT = 2.0
"""h, NIS of x and y from which on a fix's influence is bounded: its mean for right noise."""
OUTLIER_NIS = 9.21
"""NIS of x and y of an outlier, and the white member's h: right noise exceeds it in 1 %, so that it
costs white noise nothing."""
WITNESS_LIMIT = 4.0
"""NIS of the compass from which on its influence on the witness is bounded: two standard
deviations."""
OUTLIER_SHARE = 0.05
"""Share of outliers from which on they are frequent: five times as many as right noise has."""
OUTLIER_MEMORY = 0.99
"""Factor on the share of outliers per fix: it covers about a hundred."""


def outlier_share_after(share: FloatArray, seen: Comparison, fixed: BoolArray) -> FloatArray:
    """Return the share of outliers, `(*batch)`, after a fix, where `fixed` `(*batch)`."""
    outlier = seen.position_nis[WHITE] > OUTLIER_NIS
    after = OUTLIER_MEMORY * share + (1.0 - OUTLIER_MEMORY) * outlier
    return np.where(fixed, after, share)


def correct_robustly(
    bank: Bank,
    seen: Comparison,
    noise: Noise,
    rows: BoolArray,
    moves: BoolArray,
    outlier_share: FloatArray,
    rejected_yaw: BoolArray | None = None,
) -> Bank:
    """Return the filters corrected by the readings; copies are corrected by yaws alone.

    Args:
        bank: the filters; not changed.
        seen: the readings.
        noise: R of the readings without lasting errors, of one filter.
        rows: `(4, *batch)` rows that they are corrected by.
        moves: `(*batch)` whether the wheels move.
        outlier_share: `(*batch)` share of outliers among the fixes.
        rejected_yaw: `(*batch)` whether the gate rejects the compass; its advocate follows it
            nevertheless. None: it rejects none.
    """
    correcting = seen.correcting
    r, R, coupling = seen.innovation, noise.measurement, noise.coupling
    mean, covariance = bank.mean.copy(), bank.covariance.copy()
    x = np.zeros_like(mean)
    excess = _excess(seen, moves, outlier_share)
    yaw_terms: Terms = ((Component.YAW, None), (Component.YAW_DRIFT, None))
    yaw_terms = (*yaw_terms, (Component.YAW_OFFSET, None))
    which = CORRECTED
    for row, some in in_order(rows):
        if row is Row.COMPASS_YAW:
            take_row(x, covariance, yaw_terms, r[row], _compass_noise(seen), some)
        elif row is Row.LRF_YAW:
            d = (1.0 + excess) * R[row]
            terms = yaw_terms if correcting.fix_yaw.all() else _fix_yaw_terms(correcting)
            if coupling is None:
                take_row(x, covariance, terms, r[row], d, some)
                continue
            copies = COPIES
            take_row(x[:, copies], covariance[:, :, copies], terms, r[row, copies], d[copies], some)
            terms, e, left = _coupled(row, terms, r[:, which], coupling)
            take_row(x[:, which], covariance[:, :, which], terms, e, left * d[which], some)
        else:
            lasting = STATE_SIZE + row
            wider = excess[which] * (R[row] + bank.covariance[lasting, lasting, which])
            terms, e, left = ((row, None), (lasting, None)), r[row, which], 1.0
            if coupling is not None:
                terms, e, left = _coupled(row, terms, r[:, which], coupling)
            take_row(x[:, which], covariance[:, :, which], terms, e, left * (R[row] + wider), some)
    if rejected_yaw is not None and rejected_yaw.any():
        which, row = slice(ADVOCATE, ADVOCATE + 1), Row.COMPASS_YAW
        d = seen.compass_noise[which]
        take_row(x[:, which], covariance[:, :, which], yaw_terms, r[row, which], d, rejected_yaw)
    mean += x
    mean[Component.YAW] = wrap_angle(mean[Component.YAW])
    return Bank(mean, covariance)


def _compass_noise(seen: Comparison) -> FloatArray:
    """Return R of the compass, `(F, *batch)`; the witness is not pulled by a compass that turns."""
    R = seen.compass_noise.copy()
    nis = seen.witness_innovation**2 / seen.witness_variance
    R[WITNESSES] *= np.maximum(nis / WITNESS_LIMIT, 1.0)
    return R


def _excess(seen: Comparison, moves: BoolArray, outlier_share: FloatArray) -> FloatArray:
    """Return max(1, e / h) - 1, `(F, *batch)`."""
    limit = np.full((FILTER_COUNT, *outlier_share.shape), LIMIT)
    bounded = np.where(outlier_share > OUTLIER_SHARE, LIMIT, OUTLIER_NIS)
    limit[WHITE] = np.where(moves, bounded, np.inf)
    return np.asarray(np.maximum(seen.position_nis / limit, 1.0) - 1.0)


def _fix_yaw_terms(correcting: Correcting) -> Terms:
    """Return the row of a fix's yaw where some robots have a compass."""
    if not correcting.fix_yaw.any():
        return ((Component.YAW, None),)
    part = correcting.fix_yaw
    return (
        (Component.YAW, None), (Component.YAW_DRIFT, part), (Component.YAW_OFFSET, part),
    )  # fmt: skip


def _coupled(
    row: Row, terms: Terms, r: FloatArray, coupling: Coupling
) -> tuple[Terms, FloatArray, FloatArray | float]:
    """Return the row made uncorrelated with those before it: h, innovation, rest of its R."""
    others, left = coupling.of_row(row)
    e = r[row]
    for other, part in others:
        terms = (*terms, (other, part), (STATE_SIZE + other, part))
        e = e + part * r[other]
    return terms, e, left
