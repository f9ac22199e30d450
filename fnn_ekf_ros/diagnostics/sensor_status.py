# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The statuses `compass` and `lrf_pose`: silent, refused, frozen, late, disagreeing."""

from fnn_ekf_ros.diagnostics.fault_isolation import (
    BAND_CHANCE,
    CLEARED_LEAD,
    MANY_REJECTIONS,
    FaultIsolation,
    Scatter,
    Symptoms,
)
from fnn_ekf_ros.diagnostics.frozen import FrozenReadings
from fnn_ekf_ros.diagnostics.lasting_words import YawOffset
from fnn_ekf_ros.diagnostics.late_stamps import LateStamps
from fnn_ekf_ros.diagnostics.messages import SensorMessage
from fnn_ekf_ros.diagnostics.noise_words import Values
from fnn_ekf_ros.timeline.events import Level, Sensor, Status

SCATTER = {
    Scatter.AS_ASSUMED: "as the assumed noise",
    Scatter.MORE: "more than the assumed noise",
    Scatter.LESS: "less than the assumed noise",
}
"""The value of the key `scatter`."""


def measuring_status(
    common: Status,
    frozen: FrozenReadings | None,
    offset: YawOffset | None,
    late: LateStamps | None,
    symptoms: Symptoms,
    found: FaultIsolation,
) -> Status:
    """Return the status of a measuring sensor.

    Args:
        common: what can be said of any sensor.
        frozen: its readings that should have changed, if there are any.
        offset: a yaw that is off, of this sensor or of the other one.
        late: its lag, if its stamps are too late or too early.
        symptoms: of its last readings.
        found: the sensor that does not fit the others.
    """
    sensor = Sensor(common.name)
    off = offset if offset is not None and offset.sensor is sensor else None
    of_faults = _values_of_faults(frozen, off, late)
    status = common._replace(values=(*common.values, *_values(symptoms), *of_faults))
    if status.level is not Level.OK:
        return status
    if frozen is not None:
        return status._replace(level=Level.WARN, message=frozen.message)
    if off is not None and found.named in (None, sensor):
        return status._replace(level=Level.WARN, message=off.message)
    if late is not None:
        return status._replace(level=Level.WARN, message=late.message)
    if found.named is sensor:
        return status._replace(level=Level.WARN, message=_named_message(symptoms))
    calm = not found.suspects and max(found.leads) < CLEARED_LEAD
    if symptoms.scatter is Scatter.LESS and calm:  # too large an assumed noise is no fault
        return status._replace(message=SensorMessage.SCATTER_LESS)
    if symptoms.abnormal:
        return status._replace(message=SensorMessage.AFFECTED)
    return status


def _named_message(symptoms: Symptoms) -> str:
    if symptoms.rejected >= MANY_REJECTIONS:
        return SensorMessage.REJECTED
    if symptoms.scatter is Scatter.MORE:
        return SensorMessage.SCATTER_MORE
    return SensorMessage.DISAGREES


def _values_of_faults(
    frozen: FrozenReadings | None, offset: YawOffset | None, late: LateStamps | None
) -> Values:
    values: Values = ()
    if frozen is not None:
        values += tuple(frozen.values())
    if offset is not None:
        values += tuple(offset.values)
    if late is not None:
        values += late.values()
    return values


def _values(symptoms: Symptoms) -> Values:
    low, high = symptoms.band
    return (
        ("last readings", str(symptoms.seen)),
        ("rejected of the last readings", str(symptoms.rejected)),
        ("NIS per degree of freedom", f"{symptoms.nis:.2f}"),
        (f"its {1.0 - BAND_CHANCE:.1%} band", f"{low:.2f} to {high:.2f}"),
        ("scatter", SCATTER[symptoms.scatter]),
    )
