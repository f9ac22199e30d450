# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The correction of Gaussians by one scalar row of a measurement.

    s = h P h' + d,   K = P h' / s,   x <- x + K e,   P <- P - K s K'

After the row, P h' is d / s times what it was. The entries of P that the row measures are set to
this value instead of being calculated as a difference, so that the covariance stays positive
definite when a precise fix corrects a pose that was almost unknown.
"""

import numpy as np

from fnn_ekf_ros.core.arrays import BoolArray, FloatArray

Terms = tuple[tuple[int, FloatArray | None], ...]
"""Row h: the components of the state that it adds up, each with its factor `(F, *batch)` or
`(*batch)`; None: 1. The factor of the first is 1."""


def take_row(
    x: FloatArray,
    P: FloatArray,
    terms: Terms,
    innovation: FloatArray,
    d: FloatArray,
    some: BoolArray | None,
) -> tuple[FloatArray, FloatArray]:
    """Correct F Gaussians of n components by one row, in place.

    Args:
        x: `(n, F, *batch)` correction of the mean so far; changed.
        P: `(n, n, F, *batch)` covariance after the rows so far; changed.
        terms: h.
        innovation: `(F, *batch)` innovation of the row before all corrections.
        d: `(F, *batch)` variance of the row's noise.
        some: `(*batch)` robots whose row is taken; None: all of them.

    Returns:
        e / sqrt(s) and s, each `(F, *batch)`; 0 and 1 where the row is not taken.
    """
    i, others = terms[0][0], terms[1:]
    column = P[:, i]
    e = innovation - x[i]
    if others:
        column = column.copy()
        for j, part in others:
            column += P[:, j] if part is None else part * P[:, j]
            e -= x[j] if part is None else part * x[j]
    s = column[i] + d
    for j, part in others:
        s += column[j] if part is None else part * column[j]
    left = d / s
    root = np.sqrt(s)
    w = column / root
    e /= root
    if some is not None:
        w, e, s = np.where(some, w, 0.0), np.where(some, e, 0.0), np.where(some, s, 1.0)
        left = np.where(some, left, 1.0)
    x += w * e
    _update_covariance(P, i, w, left * column, others, some)
    return e, s


def _update_covariance(
    P: FloatArray,
    i: int,
    w: FloatArray,
    product: FloatArray,
    others: Terms,
    some: BoolArray | None,
) -> None:
    """Subtract K s K' from covariances, in place.

    Args:
        P: `(n, n, F, *batch)` covariance before the row; changed.
        i: the component whose factor is 1.
        w: `(n, F, *batch)` K sqrt(s); 0 where the row is not taken.
        product: `(n, F, *batch)` P h' after the row.
        others: the other components of h.
        some: `(*batch)` robots whose row is taken; None: all of them.
    """
    entries = product
    before = P[:, i].copy() if others else product
    P -= w[:, None] * w[None]
    if others:
        entries = _solved_for(i, product, others, P)
        if some is not None:  # where the row is not taken nothing changes, not even by rounding
            entries = np.where(some, entries, before)
    P[:, i] = entries
    P[i] = entries


def _solved_for(i: int, product: FloatArray, others: Terms, P: FloatArray) -> FloatArray:
    """Return the entries P_:i for a given product P h', where the row h has several components.

    Args:
        i: the component whose factor is 1.
        product: `(n, F, *batch)` P h'.
        others: the other components of h.
        P: `(n, n, F, *batch)`; its entries outside of row and column i are correct.
    """
    entries = product.copy()
    for j, part in others:
        entries -= P[:, j] if part is None else part * P[:, j]
    entries[i] = product[i]
    for j, part in others:
        entries[i] -= entries[j] if part is None else part * entries[j]
    return entries
