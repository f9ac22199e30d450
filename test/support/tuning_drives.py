# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Simulated recordings for the tests of tuning: a winding drive with known noise."""

from typing import NamedTuple

import numpy as np
from localizers import make_parameters

from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.tuning.recording import TuningRecording, schedule_of

STEP_S = 0.375


class Noise(NamedTuple):
    """True noise of a drive (standard deviations)."""

    distance: float = 0.02
    rotation: float = 0.02
    position: float = 0.1
    compass: float = 0.1
    fix_error: float = 0.0
    fix_time: float = 10.0


def drive(
    rng: np.random.Generator,
    steps: int = 800,
    noise: Noise = Noise(),  # noqa: B008 - immutable
    offset: float = 0.0,
    delay_steps: int = 0,
) -> TuningRecording:
    """Return a recording of a robot that winds left and right at changing speed.

    Args:
        rng: source of the noise.
        steps: number of epochs, each with a fix and a compass reading.
        noise: of wheels and sensors.
        offset: of the compass [rad].
        delay_steps: by how many epochs fixes come late.
    """
    t = np.arange(steps)
    speed = 0.1 * (1.0 + 0.5 * np.sin(2.0 * np.pi * t / 23.0))
    control = np.stack([speed, 0.12 * np.sin(2.0 * np.pi * t / 61.0) + 0.02])
    slip = rng.standard_normal((2, steps)) * [[noise.distance], [noise.rotation]]
    true = control + slip
    yaw = np.cumsum(true[1])
    middle = yaw - 0.5 * true[1]
    chord = true[0] * np.sinc(0.5 * true[1] / np.pi)
    position = np.cumsum(chord * np.stack([np.cos(middle), np.sin(middle)]), axis=1)
    error, phi = np.zeros((2, steps)), np.exp(-STEP_S / noise.fix_time)
    error[:, 0] = noise.fix_error * rng.standard_normal(2)
    for k in range(1, steps):
        fresh = np.sqrt(1.0 - phi * phi) * noise.fix_error * rng.standard_normal(2)
        error[:, k] = phi * error[:, k - 1] + fresh
    seen = np.concatenate([np.zeros((2, delay_steps)), position], axis=1)[:, :steps]
    z = np.zeros((4, steps))
    z[:2] = seen + error + noise.position * rng.standard_normal((2, steps))
    z[2] = yaw - offset + noise.compass * rng.standard_normal(steps)
    return recording_of(control, z)


def recording_of(control: FloatArray, z: FloatArray) -> TuningRecording:
    """Return a recording with a fix and a compass reading at each epoch, from the origin on."""
    steps = control.shape[1]
    available = np.repeat(np.array([True, True, True, False])[:, None], steps, axis=1)
    duration_s = np.full(steps, STEP_S)
    return TuningRecording(
        label="drive",
        parameters=make_parameters(),
        mean=np.zeros(3),
        covariance=np.diag([1e-2, 1e-2, 1e-2]),
        from_readings=False,
        control=control,
        duration_s=duration_s,
        measurement=z,
        available=available,
        reported=np.ones((4, steps)),
        resets={},
        schedule=schedule_of(control, duration_s, available[0]),
    )
