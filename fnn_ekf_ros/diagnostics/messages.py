# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Every message of /diagnostics: a finite set for each status, without changing numbers.

Numbers, stamps and refused values stand in the keys and values of a status. Several messages at
once are joined by `SEPARATOR`. `<name>` in a message stands for one of `NAMES[name]`.
docs/diagnostics.md lists them all with their level, meaning and remedy; a test compares the two.
"""

import itertools
from collections.abc import Iterable, Iterator
from enum import StrEnum

from fnn_ekf_ros.timeline.events import InputCheck, Sensor, Wheel

LAST_REFUSAL = "last refusal"
"""The key of the reason with which the last message of a sensor was refused."""
PASSED_OVER = "passed over"
"""The key of what the messages of a sensor say that has no reading."""
MISTAKE = "mistake"
"""Key of the sentence that says what is wrong since the start."""
FITTING = "parameter that would fit"
"""The key of a parameter and the value with which a fault would be gone."""
RECEIVED, REFUSED, LEFT_OUT, DROPPED = "received", "refused", "left out", "dropped"
"""Keys of numbers of messages of a sensor; that of dropped ones is in the status `time`."""
SEPARATOR = "; "
"""Between the messages of a status that has several; no message contains it."""

PROCESS_NOISES = ("distance", "rotation")
"""Components of Q, as the status `filter` calls them."""
MEASUREMENT_NOISES = ("fixes' x", "fixes' y", "compass", "fixes' yaw")
"""The noises that adaptation moves, as the status `filter` calls them."""

NAMES = {
    "wheel": tuple(wheel.name.lower() for wheel in Wheel),
    "sensor": tuple(Sensor),
    "measuring sensor": (Sensor.COMPASS, Sensor.LRF_POSE),
    "sensors": (
        *(" or ".join(pair) for pair in itertools.combinations(Sensor, 2)),
        " or ".join(Sensor),
    ),
    "input": (*Sensor, "initialpose"),
    "check": tuple(InputCheck),
    "process noise": PROCESS_NOISES,
    "measurement noise": MEASUREMENT_NOISES,
}
"""Meanings of the names in angle brackets."""


class InputMessage(StrEnum):
    """Messages of the statuses `encoders`, `compass` and `lrf_pose`."""

    RECEIVED = "received"
    NONE_YET = "no message yet"
    SILENT = "silent"
    REFUSED = "message refused: <check>"


class EncoderMessage(StrEnum):
    """Further messages of the status `encoders`."""

    WHEEL_NONE_YET = "no message yet from the <wheel> wheel"
    WHEEL_SILENT = "<wheel> wheel silent"
    WHEEL_STUCK = (
        "<wheel> wheel stuck: its count is constant, but the robot does not pivot about it"
    )
    WHEEL_JUMPED = "<wheel> wheel jumped: taken for a reset or a glitch, not for motion"
    WHEEL_RESTARTED = (
        "<wheel> wheel jumped after a silence: taken for a restart or a glitch, not for motion"
    )
    TIMEOUT = "periods closed without both wheels"
    DISAGREE = "disagree with the other sensors: wheel slip or an encoder fault"
    WHEEL_SMALLER = "disagree with the other sensors: the <wheel> wheel travels less than it counts"
    WHEEL_LARGER = "disagree with the other sensors: the <wheel> wheel travels more than it counts"
    WRONG_SIZE = (
        "the wheels travel more or less than they count: set wheel_radius, gear_ratio or "
        "encoder_counts_per_revolution"
    )
    WRONG_SEPARATION = "the robot rotates more or less than the wheels count: set wheel_separation"
    UNEQUAL = (
        "one wheel travels further per count than the other: set left_wheel_radius_multiplier or "
        "right_wheel_radius_multiplier"
    )
    LEFT_BACKWARD = "the left counter runs the other way: change left_inverted"
    RIGHT_BACKWARD = "the right counter runs the other way: change right_inverted"
    SWAPPED = (
        "left and right wheel are swapped: remap left_ticks and right_ticks, or exchange joints"
    )


class SensorMessage(StrEnum):
    """Further messages of the statuses `compass` and `lrf_pose`."""

    NOT_USED = "not used"
    STANDING = "no new fix, but the robot stands or stood: this does not count as silence"
    TOO_FAST = "too fast: some readings are left out"
    FROZEN_FIX = "frozen: the position does not change while the wheels move the robot"
    FROZEN_YAW = "frozen: the yaw does not change while the wheels rotate the robot"
    OFFSET = "the yaw is off by a constant angle, which is corrected"
    TURNED = "the yaw was turned: it is not used until the angle is known"
    STAMPS_LATE = "stamps seem late: the readings show where the robot was before"
    STAMPS_EARLY = "stamps seem early: the readings show where the robot was later"
    REJECTED = "many readings rejected: they disagree with the other sensors"
    SCATTER_MORE = "readings scatter more than the assumed noise"
    DISAGREES = "disagrees with the other sensors"
    SCATTER_LESS = "received, readings scatter less than the assumed noise"
    AFFECTED = "received, does not fit the other sensors, but need not be the cause"


class CompassMessage(StrEnum):
    """Mistakes in the status `compass`."""

    CLOCKWISE = "the compass counts clockwise: change compass_clockwise and set compass_offset"
    DEGREES = "the compass takes degrees for radians or radians for degrees: mend its driver"
    RANDOM = "the compass has nothing to do with the rotation: check its unit, driver and topic"
    OFF = "the compass is off by a constant angle: set compass_offset"
    DELAYED = "the stamps of the compass are late or early: set compass_delay"


class FixMessage(StrEnum):
    """Mistakes in the status `lrf_pose`."""

    YAW_OFF = "the yaw of the fixes is off by a constant angle: set lrf_yaw_offset"
    YAW_CLOCKWISE = "the yaw of the fixes counts clockwise: mend its driver"
    MIRRORED = "the fixes are mirrored: check the axes of their frame"
    UNIT = "the fixes are not in meters: set lrf_pose_scale"
    DELAYED = "the stamps of the fixes are late or early: set lrf_pose_delay"


class FilterMessage(StrEnum):
    """Messages of the status `filter`."""

    RUNNING = "running"
    AWAITS_COUNTS = "waiting for the first wheel counts"
    AWAITS_POSITION = "waiting for the first position"
    AWAITS_YAW = "waiting for the first yaw"
    AWAITS_PERIOD = "waiting for the first period of both wheels"
    LOST_POSITION = "lost: no fix accepted while driving, and the position is uncertain"
    LOST_YAW = "lost: no yaw accepted while driving, and the yaw is uncertain"
    PERIOD_FAILED = "a period failed: its measurements are left out"
    RESTARTED = "a period failed: the filter starts anew"
    MOVED = "the robot was carried, or the fixes jumped: pose moved to where the fixes agree"
    MISTAKE = "a mistake of robot, wiring or configuration: see <sensor>"
    WHEELS_DISAGREE = "encoders disagree with the other sensors"
    SENSOR_DISAGREES = "<measuring sensor> disagrees with the other sensors"
    CONTRADICTION = "measurements contradict each other: <sensors> is wrong"
    DEGRADED_POSITION = "degraded: no fix accepted while driving"
    DEGRADED_YAW = "degraded: no yaw accepted while driving"
    PROCESS_LOW = "<process noise> noise at its lower bound process_noise_std_min"
    PROCESS_HIGH = "<process noise> noise at its upper bound process_noise_std_max"
    MEASUREMENT_LOW = "<measurement noise> noise at its lower bound measurement_noise_std_min"
    MEASUREMENT_HIGH = "<measurement noise> noise at its upper bound measurement_noise_std_max"


class TimeMessage(StrEnum):
    """Messages of the status `time`."""

    IN_ORDER = "in order"
    LATE = "<input> message dropped: later than history"
    AHEAD = "<input> message dropped: stamped ahead of the clock"
    WENT_BACK = "the clock went back: the localizer starts anew"
    SET_BACK = "the clock was set back: all that is kept moves with it"
    JUMPED_AHEAD = "the clock jumped ahead: the localizer starts anew"
    PAUSED = "the clock jumped ahead, or no message arrived for a while"
    OVERRUN = "the node was late by more than a period"
    TOO_SLOW = "the node is too slow: readings are left out"


class TransformMessage(StrEnum):
    """Messages of the status `tf`."""

    PUBLISHED = "published"
    MISSING = "no transform from odom_frame to base_frame"


class OdomMessage(StrEnum):
    """Messages of the status `odom`."""

    ALONE = "published by this node alone"
    SHARED = "another node publishes odom, too"


DiagnosticMessage = (
    InputMessage
    | EncoderMessage
    | SensorMessage
    | CompassMessage
    | FixMessage
    | FilterMessage
    | TimeMessage
    | TransformMessage
    | OdomMessage
)
"""Any message of a status."""

MESSAGES: dict[str, tuple[DiagnosticMessage, ...]] = {
    "encoders": (*InputMessage, *EncoderMessage),
    "compass": (*InputMessage, *SensorMessage, *CompassMessage),
    "lrf_pose": (*InputMessage, *SensorMessage, *FixMessage),
    "filter": tuple(FilterMessage),
    "time": tuple(TimeMessage),
    "tf": tuple(TransformMessage),
    "odom": tuple(OdomMessage),
}
"""The messages of each status."""


def fill(message: DiagnosticMessage, **names: str) -> str:
    """Return a message with its names in place of the angle brackets.

    Args:
        message: with one `<name>` for each of the names.
        names: one of `NAMES` for each; a space in a name is an underscore here.
    """
    text = str(message)
    for name, value in names.items():
        text = text.replace(f"<{name.replace('_', ' ')}>", value)
    return text


def fitting_value(parameter: str, value: float) -> tuple[str, str]:
    """Return key and value of a parameter with which a fault would be gone."""
    return FITTING, f"{parameter}: {value:.2f}"


def fitting_parameters(values: Iterable[tuple[str, str]]) -> dict[str, bool | float | str]:
    """Return the parameters and values that stand under `FITTING` among those of a status."""
    texts = (text for key, all_ in values if key == FITTING for text in all_.split(SEPARATOR))
    pairs = (text.split(": ", 1) for text in texts)
    return {parameter: _read(value) for parameter, value in pairs}


def _read(text: str) -> bool | float | str:
    """Return a parameter's value as it was before it became text."""
    if text in ("true", "false"):
        return text == "true"
    try:
        return float(text)
    except ValueError:
        return text


def dropped_key(name: str) -> str:
    """Return the key of the number of dropped messages of one input."""
    return f"{DROPPED}, {name}"


def join(messages: Iterable[str]) -> str:
    """Return several messages as one text."""
    return SEPARATOR.join(messages)


def possible_texts(status: str) -> Iterator[str]:
    """Yield every text that a single message of a status can have."""
    for message in MESSAGES[status]:
        yield from texts_of(message)


def texts_of(message: str) -> Iterator[str]:
    """Yield every text that a message can have with its names filled in."""
    names = [name for name in NAMES if f"<{name}>" in message]
    for values in itertools.product(*(NAMES[name] for name in names)):
        text = str(message)
        for name, value in zip(names, values, strict=True):
            text = text.replace(f"<{name}>", value)
        yield text
