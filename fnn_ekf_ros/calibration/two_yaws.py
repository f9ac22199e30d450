# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The yaws of two sensors of one robot as evidence together."""

import math

import numpy as np

from fnn_ekf_ros.calibration.evidence import YawSource
from fnn_ekf_ros.calibration.findings import LEVEL

ALIKE = 2.0
"""Difference of two delays, in standard errors, up to which they are taken for one."""
LEAST_DELAY_STD_S = 0.02
"""Smallest standard error of a delay that is believed [s]: half a fast sensor's interval."""
UNKNOWN = 1e4
"""Standard error of coefficients that are not known, over their size."""


def delay_alone(fix_yaw: YawSource, compass: YawSource) -> YawSource | None:
    """Return a yaw of the fixes that says nothing but their delay, if the positions are as late.

    Where the yaw is not used it may come from anywhere: of wheels and directions it is no evidence.
    """
    fixes = compass.displacement
    if fixes is None or not fix_yaw.usable:
        return None
    if abs(fixes.coefficients[3]) < LEVEL * math.sqrt(fixes.covariance[3, 3]):
        return None
    coefficients = fix_yaw.fit.coefficients
    variance = max(float(fix_yaw.fit.covariance[2, 2]), LEAST_DELAY_STD_S**2)
    together = math.sqrt(variance + fixes.covariance[3, 3])
    if abs(coefficients[2] - fixes.coefficients[3]) > ALIKE * together:
        return None
    any_rotation = (UNKNOWN * np.max(np.abs(coefficients[:2]))) ** 2
    covariance = np.diag([any_rotation, any_rotation, variance])
    return YawSource(fix_yaw.fit._replace(covariance=covariance), compass.turned)


def of_one_slip(source: YawSource) -> YawSource:
    """Return one of two sensors' yaws, which see the same slip: together they count as one.

    That holds for the wheels; each sensor has a delay of its own.
    """
    scale = np.sqrt([2.0, 2.0, 1.0])
    covariance = source.fit.covariance * np.outer(scale, scale)
    return source._replace(fit=source.fit._replace(covariance=covariance))
