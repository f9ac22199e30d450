# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Motions of the plane that lay one track onto another."""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.evaluation.matching import Matched
from fnn_ekf_ros.timeline.trajectory import Trajectory


class Alignment(StrEnum):
    """How a track is moved before it is compared, as `--align` names it."""

    NONE = "none"
    SE2 = "se2"
    ORIGIN = "origin"


class Similarity(NamedTuple):
    """A rotation, with a scale and a reflection where asked for, and a translation of the plane.

    Attributes:
        rotation: counter-clockwise [rad].
        x: translation along x, after the rotation [m].
        y: along y [m].
        scale: factor on lengths.
        mirrored: whether y is negated before the rotation.
    """

    rotation: float
    x: float
    y: float
    scale: float = 1.0
    mirrored: bool = False

    def matrix(self) -> FloatArray:
        """Return the `(2, 2)` matrix that acts on positions before the translation."""
        c, s = math.cos(self.rotation), math.sin(self.rotation)
        side = -1.0 if self.mirrored else 1.0
        return self.scale * np.array([[c, -side * s], [s, side * c]])

    def poses(self, pose: FloatArray) -> FloatArray:
        """Return poses `(n, 3)` after the motion (m, m, rad)."""
        side = -1.0 if self.mirrored else 1.0
        xy = pose[:, :2] @ self.matrix().T + (self.x, self.y)
        return np.column_stack([xy, wrap_angle(side * pose[:, 2] + self.rotation)])

    def covariances(self, covariance: FloatArray) -> FloatArray:
        """Return covariances `(n, 3, 3)` of poses after the motion."""
        full = np.eye(3)
        full[:2, :2] = self.matrix()
        full[2, 2] = -1.0 if self.mirrored else 1.0
        with np.errstate(invalid="ignore"):  # covariances that are none stay so
            moved: FloatArray = full @ covariance @ full.T
        return moved


STILL = Similarity(0.0, 0.0, 0.0)
"""No motion of the plane."""


def fit(
    source: FloatArray, target: FloatArray, *, with_scale: bool = False, mirrored: bool = False
) -> Similarity:
    """Return the motion of the plane that lays points onto others with the least squares.

    With s and t the points less their means as complex numbers (s conjugated where mirrored), the
    rotation is arg sum(t s*), the scale |sum(t s*)| / sum |s|^2: Umeyama 1991, eqs. 40-42, in the
    plane.

    Args:
        source: `(n, 2)` points to move [m].
        target: `(n, 2)` where they ought to be [m].
        with_scale: whether lengths may change.
        mirrored: whether y is negated first.
    """
    side = np.array([1.0, -1.0 if mirrored else 1.0])
    mean_source, mean_target = np.mean(source, axis=0), np.mean(target, axis=0)
    s, t = ((points - mean) @ (1.0, 1.0j) for points, mean in (
        (source * side, mean_source * side), (target, mean_target)))  # fmt: skip
    product, size = complex(np.vdot(s, t)), float(np.vdot(s, s).real)
    rotation = math.atan2(product.imag, product.real)
    scale = abs(product) / size if with_scale and size > 0.0 else 1.0
    turned = Similarity(rotation, 0.0, 0.0, scale, mirrored)
    x, y = mean_target - turned.matrix() @ mean_source
    return turned._replace(x=float(x), y=float(y))


def aligned(matched: Matched, alignment: Alignment) -> tuple[Matched, Similarity]:
    """Return a track after its alignment with the truth, and the motion of the plane.

    `se2` moves all of it for the least squares of the distances (evo's --align in the plane,
    without scale), `origin` lays its first pose onto the true one (evo's --align_origin; where the
    truth has no yaw, by the position alone).
    """
    if alignment is Alignment.NONE:
        return matched, STILL
    motion = STILL
    if alignment is Alignment.SE2:
        motion = fit(matched.estimate[:, :2], matched.truth[:, :2])
    elif alignment is Alignment.ORIGIN:
        first, true = matched.estimate[0], matched.truth[0]
        rotation = true[2] - first[2] if np.isfinite(true[2]) else 0.0
        turned = Similarity(float(wrap_angle(rotation)), 0.0, 0.0)
        x, y = true[:2] - turned.matrix() @ first[:2]
        motion = turned._replace(x=float(x), y=float(y))
    moved = matched._replace(
        estimate=motion.poses(matched.estimate), covariance=motion.covariances(matched.covariance)
    )
    return moved, motion


def aligned_track(track: Trajectory, motion: Similarity) -> Trajectory:
    """Return all of a track after a motion of the plane."""
    return Trajectory(
        track.time_ns, motion.poses(track.pose), motion.covariances(track.covariance), track.frame
    )
