"""What the localizer says about compass and lrf_pose: silent, refused, frozen, not fitting."""

from fnn_ekf_ros.pipeline.belief import Values
from fnn_ekf_ros.pipeline.blame import (
    BAND_CHANCE,
    CLEARED_LEAD,
    MANY_REJECTIONS,
    Blame,
    Scatter,
    Symptoms,
)
from fnn_ekf_ros.pipeline.events import Level, Sensor, Status

OTHERS = {
    Sensor.ENCODERS: "the compass and the fixes",
    Sensor.COMPASS: "the wheels and the fixes",
    Sensor.LRF_POSE: "the wheels and the compass",
}
"""Whom a sensor disagrees with."""
SCATTER = {
    Scatter.AS_BELIEVED: "as believed",
    Scatter.MORE: "more than believed",
    Scatter.LESS: "less than believed",
}


def measuring_status(common: Status, frozen: str, symptoms: Symptoms, found: Blame) -> Status:
    """Return how a measuring sensor is.

    Args:
        common: what can be said of any sensor.
        frozen: what is wrong if it is frozen, otherwise empty.
        symptoms: of its last readings.
        found: who is to blame for what does not fit.
    """
    sensor = Sensor(common.name)
    status = common._replace(values=(*common.values, *_values(symptoms)))
    if status.level is not Level.OK:
        return status
    if frozen:
        return status._replace(level=Level.WARN, message=frozen)
    if found.culprit is sensor:
        return status._replace(level=Level.WARN, message=_accusation(sensor, symptoms))
    calm = not found.suspects and max(found.leads) < CLEARED_LEAD
    if symptoms.scatter is Scatter.LESS and calm:  # cautious noise is no fault
        message = f"received; its readings scatter less than believed: {_against_band(symptoms)}"
        return status._replace(message=message)
    if symptoms.wild:
        return status._replace(message="received; does not fit, but it need not be to blame")
    return status


def _accusation(sensor: Sensor, symptoms: Symptoms) -> str:
    if symptoms.rejected >= MANY_REJECTIONS:
        return (
            f"{symptoms.rejected} of the last {symptoms.seen} readings rejected: they disagree "
            f"with {OTHERS[sensor]}"
        )
    if symptoms.scatter is Scatter.MORE:
        return f"its readings scatter more than believed: {_against_band(symptoms)}"
    return f"disagrees with {OTHERS[sensor]}"


def _against_band(symptoms: Symptoms) -> str:
    low, high = symptoms.band
    return f"NIS {symptoms.nis:.2f} per degree of freedom, expected {low:.2f} to {high:.2f}"


def _values(symptoms: Symptoms) -> Values:
    low, high = symptoms.band
    return (
        (f"rejected of the last {symptoms.seen}", str(symptoms.rejected)),
        ("NIS per degree of freedom", f"{symptoms.nis:.2f}"),
        (f"its {1.0 - BAND_CHANCE:.1%} band", f"{low:.2f} to {high:.2f}"),
        ("scatter", SCATTER[symptoms.scatter]),
    )
