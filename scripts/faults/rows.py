# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The rows of the fault matrix."""

from typing import Any

from faults.scenarios import LASTS_S, ONSET_S, FaultScenario

BOTH = ("compass", "lrf_pose")
"""Topics of both sensors with stamps."""


def once(fault: str, **keys: Any) -> dict[str, Any]:
    """Return a fault that happens at the onset."""
    return {"fault": fault, "start": ONSET_S, **keys}


def lasting(fault: str, **keys: Any) -> dict[str, Any]:
    """Return a fault that lasts from the onset on."""
    return {"fault": fault, "start": ONSET_S, "duration": LASTS_S, **keys}


def shown(topic: str) -> str:
    """Return what a topic's sensor is called."""
    return {"lrf_pose": "fixes"}.get(topic, topic)


def of_both(name: str, meaning: str, fault: str, **keys: Any) -> list[FaultScenario]:
    """Return a lasting fault's rows, of the compass and of the fixes; `keys` the same for both."""
    return [
        FaultScenario(f"{shown(topic)}: {name}", meaning, (lasting(fault, topic=topic, **keys),))
        for topic in BOTH
    ]


def row(name: str, meaning: str, *timeline: dict[str, Any], **keys: Any) -> FaultScenario:
    """Return a row."""
    return FaultScenario(name, meaning, timeline, **keys)


LATE = lasting("delay", topic="lrf_pose", size=0.15)
"""Fault of fixes that come 0.15 s late."""
UNDISTURBED = {
    False: row("no fault", "joint_states"),
    True: row("no fault, ticks", "ticks, stamped on arrival", ticks=True),
}
"""Rows without a fault, by whether the encoders are ticks."""
ROWS: tuple[FaultScenario, ...] = (
    *UNDISTURBED.values(),
    row("slip", "wet or smooth ground", lasting("slip", factor=5.0)),
    row("unequal wheels", "a flat tire, a load on one side",
        lasting("unequal_wheels", wheel="left", factor=1.05)),
    row("kidnap, 20 m", "carried away by people", once("kidnap", move=[16.0, 12.0, 1.0])),
    row("stuck wheel", "an encoder's disc is loose", lasting("stuck_wheel", wheel="left")),
    row("stuck wheel, ticks", "the same", lasting("stuck_wheel", wheel="left"), ticks=True),
    row("silent wheel", "a cable is off", lasting("silent_wheel", wheel="left")),
    row("silent wheel, ticks", "the same", lasting("silent_wheel", wheel="left"), ticks=True),
    row("both wheels silent", "the motor controller is off", lasting("silent_wheel", wheel="both")),
    row("tick reset", "the motor controller starts anew", once("tick_reset", wheel="both", count=0),
        ticks=True),
    row("joint_states reset", "the same", once("tick_reset", wheel="both", count=0)),
    row("tick glitch", "a bit flips on the bus",
        once("tick_glitch", wheel="right", size=100_000), ticks=True),
    row("8-bit counters", "they wrap every 0.27 s: nothing is wrong", ticks=True,
        localizer=("encoder_bits:=8",), robot=("encoder_bits:=8",)),
    row("joint_states: dropout", "the same as both wheels silent",
        lasting("dropout", topic="joint_states")),
    row("joint_states: 30 % lost", "a bad radio",
        lasting("dropout", topic="joint_states", rate=0.3)),
    row("joint_states: delay 0.15 s", "a busy computer",
        lasting("delay", topic="joint_states", size=0.15)),
    row("joint_states: NaN", "a driver's division by zero", lasting("nan", topic="joint_states")),
    row("joint_states: reordered", "UDP", lasting("reordered", topic="joint_states")),
    row("joint_states: stamps 5 s ahead", "clocks not synchronized",
        lasting("wrong_stamp", topic="joint_states", size=5.0)),

    *of_both("dropout", "no view of walls, a cable is off", "dropout"),
    *of_both("half of them lost", "a bad radio", "dropout", rate=0.5),
    row("compass: delay 0.15 s", "a slow driver", lasting("delay", topic="compass", size=0.15)),
    row("fixes: delay 0.15 s", "a scan matcher computes", LATE),
    row("fixes: delay 0.15 s, output_delay 0.2", "the same, waited for", LATE,
        localizer=("output_delay:=0.2",)),
    row("fixes: delay 3 s", "longer than history", lasting("delay", topic="lrf_pose", size=3.0)),
    row("fixes: one is lost", "a bad radio", once("dropout", topic="lrf_pose", duration=0.375)),
    row("fixes: a lone 20 m outlier", "a wrong match; moved: against the row above",
        once("outliers", topic="lrf_pose", duration=0.375, size=20.0, rate=1.0),
        without="fixes: one is lost"),
    row("fixes: 10 % at 20 m", "repeated wrong matches",
        lasting("outliers", topic="lrf_pose", size=20.0, rate=0.1)),
    row("compass: a lone outlier of 1.5 rad", "a motor starts", once("outliers", topic="compass",
        duration=0.125, size=1.5, rate=1.0)),
    row("compass: 10 % at 1.5 rad", "a motor starts again and again",
        lasting("outliers", topic="compass", size=1.5, rate=0.1)),
    row("compass: bias 0.3 rad", "iron nearby",
        lasting("bias", topic="compass", size=[0.0, 0.0, 0.3])),
    row("fixes: bias 0.5 m", "furniture moved", lasting("bias", topic="lrf_pose",
        size=[0.3, 0.4, 0.0])),
    *of_both("noise x5", "people in the view, motors nearby", "noise", factor=5.0),
    *of_both("frozen", "the driver hangs, and sends on", "frozen"),
    *of_both("duplicates", "two paths of the network", "duplicates"),
    *of_both("reordered", "UDP", "reordered"),
    *of_both("burst", "the network stalls, then all comes at once", "burst"),
    *of_both("stamps 5 s ahead", "clocks not synchronized", "wrong_stamp", size=5.0),
    *of_both("stamps 0.5 s ahead", "clocks not synchronized", "wrong_stamp", size=0.5),
    *of_both("stamps 0.5 s behind", "clocks not synchronized", "wrong_stamp", size=-0.5),
    *of_both("stamps 5 s behind", "clocks not synchronized", "wrong_stamp", size=-5.0),
    *of_both("NaN", "a driver's division by zero", "nan"),
    *of_both("zero quaternion", "never filled in", "zero_quaternion"),
    row("fixes: zero quaternion, lrf_use_yaw", "never filled in, but needed",
        lasting("zero_quaternion", topic="lrf_pose"), localizer=("lrf_use_yaw:=true",)),
    *of_both("wrong frame", "a wrong configuration", "wrong_frame", frame="odom"),
    row("compass: degrees for radians", "a wrong unit",
        lasting("wrong_unit", topic="compass", factor=57.29578)),
    row("fixes: millimeters for meters", "a wrong unit",
        lasting("wrong_unit", topic="lrf_pose", factor=1000.0)),
    row("fixes: bad covariance, used", "never filled in",
        lasting("bad_covariance", topic="lrf_pose"),
        localizer=("lrf_use_message_covariance:=true",)),
    row("fixes: bad covariance, not used", "the same where it does not matter",
        lasting("bad_covariance", topic="lrf_pose")),
    row("compass: covariance -1", "an IMU that says it has no yaw",
        lasting("bad_covariance", topic="compass", variance=-1.0)),
    row("everything that measures is silent", "dead reckoning is left",
        *(lasting("dropout", topic=topic) for topic in BOTH)),
    row("clock: 30 s forward", "NTP sets the clock", once("clock_jump", size=30.0)),
    row("clock: 10 s back", "the same, or a recording loops", once("clock_jump", size=-10.0)),
    row("clock: 0.5 s back", "NTP sets the clock", once("clock_jump", size=-0.5)),
)  # fmt: skip
"""All rows, in the document's order."""
