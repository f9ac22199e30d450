# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is believed of errors that last, in a few plain words, and a yaw that is off."""

from typing import NamedTuple

from fnn_ekf_ros.core.angles import wrap_angle
from fnn_ekf_ros.core.lasting.members import LASTING_SHARE
from fnn_ekf_ros.core.lasting.report import LastingReport
from fnn_ekf_ros.diagnostics.messages import SensorMessage, fitting_value
from fnn_ekf_ros.diagnostics.noise_words import Values
from fnn_ekf_ros.timeline.events import Sensor


class YawOffset(NamedTuple):
    """A yaw that is off by a constant angle, or was turned.

    Attributes:
        sensor: that measures it.
        message: of its status.
        values: the angle and its remedy.
    """

    sensor: Sensor
    message: SensorMessage
    values: Values


def lasting_in_words(report: LastingReport) -> Values:
    """Return what is believed of errors that last, of a single filter."""
    parts = []
    during = f"that last about {report.time_constant_s:.0f} s"
    if report.fixes_last > LASTING_SHARE:
        parts.append(f"fix errors of {report.fix_std:.2g} m {during}")
    if report.yaws_last > LASTING_SHARE:
        parts.append(f"yaw errors of {report.yaw_std:.2g} rad {during}")
    if report.doubted:
        parts.append("compass turned")
    elif report.believed:
        whose = "fixes' yaw" if report.of_fix_yaw else "compass"
        parts.append(f"{whose} offset {report.offset:.2f} rad")
    return (("lasting errors", "; ".join(parts) or "none"),)


def yaw_offset(report: LastingReport, compass_offset: float) -> YawOffset | None:
    """Return the yaw that is believed to be off, or was turned; None if there is none.

    Args:
        report: of a single filter.
        compass_offset: the parameter as it is [rad].
    """
    if report.doubted:
        return YawOffset(Sensor.COMPASS, SensorMessage.TURNED, _values(report))
    if not report.believed:
        return None
    if report.of_fix_yaw:
        return YawOffset(Sensor.LRF_POSE, SensorMessage.OFFSET, _values(report))
    fitting = float(wrap_angle(compass_offset - report.offset))
    remedy = fitting_value("compass_offset", fitting)
    return YawOffset(Sensor.COMPASS, SensorMessage.OFFSET, (*_values(report), remedy))


def doubtful_yaw(report: LastingReport) -> Sensor | None:
    """Return the sensor whose yaw is off or likely to be, if there is one.

    A believed offset counts, too: its estimate goes on moving, and what is left of it shows in the
    other sensors.
    """
    if not (report.doubted or report.likely or report.believed):
        return None
    return Sensor.LRF_POSE if report.of_fix_yaw else Sensor.COMPASS


def _values(report: LastingReport) -> Values:
    return (
        ("yaw offset [rad]", f"{report.offset:.3f}"),
        ("yaw offset std [rad]", f"{report.offset_std:.3f}"),
    )
