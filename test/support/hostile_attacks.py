# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What can be done to one message, so that it is hostile."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from fnn_ekf_ros import messages
from fnn_ekf_ros.messages import Message

Random = np.random.Generator
_MAX = float(np.finfo(np.float64).max)
EXTREME = (
    math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, -5e-324, 1e-310, 1e-160, 1e-12, -1e-9, 1e-4,
    0.5, -1.0, 1.0, math.pi, -math.pi, math.nextafter(math.pi, 4.0), 1e3, -1e3, 1e6, 99_999_999.9,
    -99_999_999.9, 1e8, 1e15, 2.0**53 + 2.0, 1e17, -1e154, 1e155, 1e300, _MAX, -_MAX,
)  # fmt: skip
INT32 = (-(2**31), -(2**31) + 1, -65536, -1, 0, 1, 127, 128, 255, 65535, 2**31 - 2, 2**31 - 1)
FRAMES = (
    "",
    "odom",
    "/map",
    "map ",
    "MAP",
    "x" * 5000,
    "a\nb",
    "\x00",
    "карта",
    "\ufffd\U0001f916",
)


def pick(rng: Random, values: Any) -> Any:
    return values[int(rng.integers(len(values)))]


def log_uniform(rng: Random, low: float, high: float, size: int) -> np.ndarray:
    return np.exp(rng.uniform(math.log(low), math.log(high), size))


def time_fields(stamp_ns: int) -> dict[str, int]:
    """Return the fields of a stamp, held within what the message can hold."""
    sec, nanosec = divmod(stamp_ns, 10**9)
    return {"sec": min(max(sec, -(2**31)), 2**31 - 1), "nanosec": nanosec}


def _numbers(rng: Random, message: Message) -> None:
    """Replace some numbers with extreme ones."""
    for name, value in message.fields.items():
        if isinstance(value, Message):
            _numbers(rng, value)
        elif isinstance(value, float):
            if rng.random() < 0.3:
                message.fields[name] = pick(rng, EXTREME)
        elif isinstance(value, np.ndarray) and value.size:
            hit = rng.random(value.shape) < 0.1
            value[hit] = rng.choice(EXTREME, int(np.sum(hit)))


def _orientation_of(message: Message) -> dict[str, Any] | None:
    if "pose" in message.fields:
        fields: dict[str, Any] = message.fields["pose"].fields["pose"].fields["orientation"].fields
        return fields
    return message.fields["orientation"].fields if "orientation" in message.fields else None


def _quaternions(rng: Random, message: Message) -> None:
    """Turn it anywhere in space, and off unit length."""
    fields = _orientation_of(message)
    if fields is None:
        return
    q = rng.normal(size=4)
    q /= np.linalg.norm(q)
    q *= pick(rng, (0.0, 1e-200, 0.89, 0.91, 1.0, 1.0, 1.0, 1.09, 1.11, 1e160, math.nan, math.inf))
    with np.errstate(invalid="ignore"):
        fields.update(zip("xyzw", (float(value) for value in q), strict=True))


def _covariances(rng: Random, message: Message) -> None:
    """Usable covariances from tiny to huge, and others."""
    if "pose" in message.fields:
        message.fields["pose"].fields["covariance"] = covariance_from(rng).ravel()
    elif "orientation_covariance" in message.fields:
        first = pick(rng, (-1.0, 0.0, math.nan, 1e300))
        message.fields["orientation_covariance"] = np.array([first, *[0.0] * 8])


def covariance_from(rng: Random) -> np.ndarray:
    low, high = pick(rng, ((1e-4, 1e3), (1e-4, 2e-4), (500.0, 1e3), (1e-2, 1.0), (1e-9, 1e9)))
    std = log_uniform(rng, low, high, 6)
    directions = rng.normal(size=(6, pick(rng, (1, 2, 6, 40))))
    correlation = directions @ directions.T
    scale = np.sqrt(np.diag(correlation))
    margin = pick(rng, (0.0, 1e-13, 1e-7, 2e-6, 1e-2))
    correlation = (1.0 - margin) * correlation / np.outer(scale, scale) + margin * np.eye(6)
    covariance = correlation * np.outer(std, std)
    how = int(rng.integers(9))
    if how == 0:
        covariance[:] = 0.0
    elif how == 1:
        covariance[pick(rng, (0, 1, 5)), pick(rng, (0, 1, 5))] *= -1.0
    elif how == 2:
        covariance[0, 1] *= 1.0 + pick(rng, (1e-9, 1e-5, 1.0))
    elif how == 3:
        covariance[pick(rng, (0, 1, 5)), pick(rng, (0, 1, 5))] = pick(rng, EXTREME)
    return covariance


def _frames(rng: Random, message: Message) -> None:
    """Name another frame, or none."""
    if "header" in message.fields:
        message.fields["header"].fields["frame_id"] = pick(rng, FRAMES)


def _joints(rng: Random, message: Message) -> None:
    """Leave joints out, name them twice, give too few or too many positions."""
    if "position" not in message.fields:
        return
    fields = message.fields
    how = int(rng.integers(6))
    if how == 0:
        fields["name"] = fields["name"][: int(rng.integers(3))]
    elif how == 1:
        fields["name"] = ["", "arm", *fields["name"], *fields["name"]]
    elif how == 2:
        fields["position"] = fields["position"][: int(rng.integers(2))]
    elif how == 3:
        fields["position"] = np.append(fields["position"], pick(rng, EXTREME))
    elif how == 4:
        fields["position"] = np.array([pick(rng, EXTREME), pick(rng, EXTREME)])
    else:
        fields["name"], fields["position"] = fields["name"][::-1], np.empty(0)


def _counts(rng: Random, message: Message) -> None:
    """Jumping counters and wheels."""
    if "data" in message.fields:
        count = pick(rng, INT32) if rng.random() < 0.5 else int(rng.integers(-(2**31), 2**31))
        message.fields["data"] = count
    elif "position" in message.fields:
        jump = rng.normal(size=len(message.fields["position"])) * 10.0 ** rng.uniform(-2.0, 7.0)
        message.fields["position"] = message.fields["position"] + jump


def _stamps(rng: Random, message: Message) -> None:
    """Stamps of 0, of other times, and of no time at all."""
    if "header" not in message.fields:
        return
    stamp = message.fields["header"].fields["stamp"].fields
    how = int(rng.integers(5))
    if how == 0:
        stamp.update(sec=0, nanosec=0)
    elif how == 1:
        stamp.update(sec=pick(rng, INT32), nanosec=pick(rng, (0, 999_999_999, 2**32 - 1)))
    else:
        lead_s = (rng.uniform(-12.0, 1.1), rng.uniform(-0.4, 0.1), rng.normal() * 1e6)[how - 2]
        stamp_ns = stamp["sec"] * 10**9 + stamp["nanosec"] + round(lead_s * 1e9)
        stamp.update(time_fields(stamp_ns))


def _places(rng: Random, message: Message) -> None:
    """Readings that look right but are of another place."""
    if "pose" in message.fields:
        position = message.fields["pose"].fields["pose"].fields["position"].fields
        far = 10.0 ** rng.uniform(-1.0, 7.9)
        position["x"] += float(rng.normal() * far)
        position["y"] += float(rng.normal() * far)
    fields = _orientation_of(message)
    if fields is not None:
        fields.update(messages.quaternion(float(rng.uniform(-math.pi, math.pi))).fields)


ATTACKS: dict[str, Callable[[Random, Message], None]] = {
    "numbers": _numbers,
    "quaternions": _quaternions,
    "covariances": _covariances,
    "frames": _frames,
    "joints": _joints,
    "counts": _counts,
    "stamps": _stamps,
    "places": _places,
}
"""What happens to one message."""
