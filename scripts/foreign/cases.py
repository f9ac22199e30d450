# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Scenarios of the tests and issues of other localizers, as faults of the simulated robot."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from fnn_ekf_ros.parameters.fault_files import faults_from
from foreign import equal
from foreign.runs import NO_SHIFT, Measured, Spoil, drive, fix_variance, recovery

ONSET_S = 30.0
"""Time of a drive at which things go wrong [s], unless they do from the start: the filter has
settled."""
AFTER_S = 30.0
"""Time of a drive after what is counted from [s]."""
NEW_PLACE = (2.0, -1.0, 0.0)
"""Change of the place of PX4's test of a reset to the GPS position (m, m, rad): 2.2 m."""
LARGEST_DOUBLE = 1.7976931348623157e308
"""Variance that kobuki gives for what it does not measure (m^2, rad^2)."""
GLITCH_S = 29.0 / 64.0
"""Duration of an offset of ArduPilot's GPS glitch [s]: 1 / 2.2 Hz, cut so that sums are exact."""
GLITCH_M = (
    (33.4, 6.5), (77.5, 8.3), (105.0, 25.1), (111.2, 23.8), (105.1, 25.5), (85.9, 18.6),
    (69.3, 11.8),
)  # fmt: skip
"""Its offsets north and east [m]: degrees times 111.319 km, east also times cos(35.363 degrees)."""


def fault(name: str, start: float = ONSET_S, **keys: Any) -> dict[str, Any]:
    """Return an entry of a timeline."""
    return {"fault": name, "start": start, **keys}


def compass_off(angle: float, start: float = ONSET_S, **keys: Any) -> dict[str, Any]:
    """Return an entry: the compass is off by an angle [rad]."""
    return fault("bias", start, topic="compass", size=[0.0, 0.0, angle], **keys)


def fixes_off(x: float, y: float, start: float = ONSET_S, **keys: Any) -> dict[str, Any]:
    """Return an entry: the fixes are off [m]."""
    return fault("bias", start, topic="lrf_pose", size=[x, y, 0.0], **keys)


def no_fixes(duration: float) -> dict[str, Any]:
    """Return an entry: no fix comes for a time [s]."""
    return fault("dropout", topic="lrf_pose", duration=duration)


def glitches() -> list[dict[str, Any]]:
    """Return ArduPilot's GPS glitch, an entry for each of its offsets."""
    return [
        fixes_off(x, y, ONSET_S + number * GLITCH_S, duration=GLITCH_S)
        for number, (x, y) in enumerate(GLITCH_M)
    ]


def recovers(
    timeline: Sequence[Mapping[str, Any]] = (),
    *,
    onset_s: float = ONSET_S,
    since_s: float = ONSET_S,
    shift: tuple[float, float, float] = NO_SHIFT,
    localizer: Mapping[str, Any] = {},
    spoil: Spoil | None = None,
    own_clock: bool = False,
    after_s: float = AFTER_S,
) -> Callable[[int], Measured]:
    """Return a measurement of how a run recovers, for a seed.

    Args:
        timeline: the faults.
        onset_s: from when on errors and messages count [s].
        since_s: from when on the recovery is counted [s].
        shift: by how much the map moves at the onset: the new place is right (m, m, rad).
        localizer: parameters that differ from the defaults.
        spoil: changes messages.
        own_clock: whether the localizer runs on the computer whose clock jumps.
        after_s: for how long the drive goes on after `since_s` [s].
    """
    faults = faults_from(list(timeline), "scenario")

    def measure(seed: int) -> Measured:
        run = drive(
            seed, since_s + after_s, faults,
            localizer=localizer, spoil=spoil, own_clock=own_clock,
        )  # fmt: skip
        return Measured(recovery(run, onset_s, since_s, shift))

    return measure


class Scenario(NamedTuple):
    """A scenario of another localizer.

    Attributes:
        name: of a few words.
        source: repository with the file or the issue.
        happens: what goes wrong, there and here.
        theirs: what is published about the other localizer.
        remark: what makes the figures hard to compare, and what is worse here.
        measure: runs it with a seed.
    """

    name: str
    source: str
    happens: str
    theirs: str
    remark: str
    measure: Callable[[int], Measured]


PX4 = "PX4/PX4-Autopilot, src/modules/ekf2/test"
ARDUPILOT = "ArduPilot/ardupilot, Tools"
RL, FUSIONCORE = "cra-ros-pkg/robot_localization", "manankharwar/fusioncore"
NO_SCENARIO = "nothing goes wrong"
"""Name of the row that the others are read against."""
USED = {"lrf_use_message_covariance": True}
"""Parameters of a localizer that uses the covariances of the fixes."""
PLANE, REST = (0, 1, 5), (2, 3, 4)
"""Entries of a covariance's diagonal: x, y and yaw; z, roll and pitch."""
NO_DELAY_S, LATE_S = 2.5, 2.0
"""Delay of odom that waits for late fixes, and how late they are [s]."""
BLACKOUT_S, CLUSTER_S, CLUSTER_M = 211.0, 24.0, 780.0
"""Time without a fix, time with fixes that are off, and by how much, in the middle, in
FusionCore's issue 64 [s, s, m]."""
LONG_BLACKOUT_S = 461.0
"""Time without a fix in FusionCore's issue 120 [s]."""
SURE = {"process_noise_std": [0.005, 0.005]}
"""Process noise that is a tenth of the true one (m, rad)."""

RECOVERIES = (
    Scenario(
        NO_SCENARIO, "", "nothing; the last 30 s of 60 s", "", "", recovers(),
    ),
    Scenario(
        "fixes return 2.2 m away",
        f"{PX4}/test_EKF_gps.cpp, resetToGpsPosition",
        "no fix for 11 s; then all of them are off by (2, -1) m, which is the right place from "
        "then on",
        "at the new place, to 1 cm, 0.1 s after the first fix",
        "Theirs is at rest, and without noise. PX4 moves to the first fix after a time without "
        "any; here a fix outside of the gate has to be confirmed eight times over 3 s, and one "
        "inside of it corrects by its weight.",
        recovers(
            (no_fixes(11.0), fixes_off(*NEW_PLACE[:2], ONSET_S + 11.0)),
            onset_s=ONSET_S + 11.0, since_s=ONSET_S + 11.0, shift=NEW_PLACE,
        ),
    ),
    Scenario(
        "yaw off by 110 degrees from the start",
        f"{PX4}/test_EKF_gps_yaw.cpp, fallBackToYawEmergencyEstimator",
        "the only yaw sensor is off by 110 degrees from the first reading on",
        "yaw right to 5 degrees after 5 s of acceleration",
        "Times are since the robot's start; a run lasts 60 s. Theirs measures velocities by GPS "
        "and accelerations; here yaw follows from wheels and positions, whose noise is 0.1 m at "
        "0.3 m/s.",
        recovers(
            (compass_off(math.radians(110.0), 0.0),), onset_s=0.0, since_s=0.0,
            after_s=2.0 * AFTER_S,
        ),
    ),
    Scenario(
        "yaw jumps by 180 degrees",
        f"{PX4}/test_EKF_gps_yaw.cpp, yawJumpInAir",
        "the yaw sensor jumps by 180 degrees for good; the robot does not turn",
        "the yaw is reset once, within 7.5 s",
        "PX4 follows the sensor once, by design; here the sensor is wrong, so that to follow it "
        "is an error. While the compass is not used, the yaw is less certain.",
        recovers((compass_off(math.pi),)),
    ),
    Scenario(
        "yaw jumps by 180 degrees and back",
        f"{PX4}/test_EKF_gps_yaw.cpp, yawJumpInAir",
        "the same, and 7.5 s later by 180 degrees again",
        "the sensor is no longer used",
        "Times are since the onset.",
        recovers((compass_off(math.pi, duration=7.5),)),
    ),
    Scenario(
        "GPS glitch",
        f"{ARDUPILOT}/autotest/arducopter.py, GPSGlitchLoiter",
        "seven offsets of 34 to 114 m, 2.2 a second; right fixes after them",
        "the copter stays within 20 m of its place for 30 s",
        "Theirs is the motion of a vehicle that holds its position, not the estimate's error.",
        recovers(glitches(), since_s=ONSET_S + len(GLITCH_M) * GLITCH_S),
    ),
    Scenario(
        "GPS glitch that stays",
        f"{ARDUPILOT}/autotest/arducopter.py, GPSGlitchLoiter2",
        "all fixes are off by 111 m for 20 s; right ones after them",
        "roll and pitch stay within 2 degrees; the position is not tested",
        "The pose follows: fixes that agree for 3 s are taken for a robot that was carried. There "
        "is no parameter against it.",
        recovers((fixes_off(111.3, 0.0, duration=20.0),), since_s=ONSET_S + 20.0),
    ),
    Scenario(
        "good fixes outside of the gate",
        f"{FUSIONCORE}, issue 38",
        "the robot is carried by 300 m; all fixes are right",
        "the gate rejects fixes continuously, which lets the state drift, which rejects the next "
        "ones: 28.6 m of ATE on NCLT 2012-11-04, and 9.6 m for the EKF of robot_localization. "
        "7340 good fixes in a row: not verified",
        "Theirs is a recording. Here the rejections end with the eighth confirmation.",
        recovers((fault("kidnap", move=[300.0, 0.0, 0.0]),)),
    ),
    Scenario(
        "no fixes for 461 s",
        f"{FUSIONCORE}, issue 120",
        "no fix for 461 s, in which the left wheel is 5 % larger; then good ones",
        "300 s after them 277 m off without a way to recover, 13.4 m with one, 259.5 m with "
        "another gate before it",
        "Theirs is a recording of a robot without a compass (NCLT 2012-06-15); here a compass is "
        "left, and the path is a small one.",
        recovers(
            (
                no_fixes(LONG_BLACKOUT_S),
                fault("unequal_wheels", wheel="left", factor=1.05, duration=LONG_BLACKOUT_S),
            ),
            since_s=ONSET_S + LONG_BLACKOUT_S,
        ),
    ),
    Scenario(
        "no fixes and a filter that is too sure",
        f"{FUSIONCORE}, pull request 15",
        "process noise configured as a tenth of the true one; no fix and no yaw for 120 s, then "
        "good ones",
        "with a receiver that reports 3 mm (std) the gate rejects every fix once the estimate has "
        "drifted by 1 cm",
        "There the receiver is too sure, here the filter. The only row whose localizer has a wrong "
        "noise.",
        recovers(
            (no_fixes(120.0), fault("dropout", topic="compass", duration=120.0)),
            since_s=ONSET_S + 120.0, localizer=SURE,
        ),
    ),
    Scenario(
        "cluster of wrong fixes after a time without",
        f"{FUSIONCORE}, issue 64 and docs/known-limitations.md",
        "no fix for 211 s, then all are off by 780 m for 24 s, then good ones",
        "accepted: about 788 m off, and back within 2 minutes. Issue 117, with 460 s and 700 m: "
        "613 m off at the end",
        "The cluster is followed here, too: after so long nothing tells it from a robot that was "
        "carried. What differs is the way back.",
        recovers(
            (
                no_fixes(BLACKOUT_S),
                fixes_off(CLUSTER_M, 0.0, ONSET_S + BLACKOUT_S, duration=CLUSTER_S),
            ),
            since_s=ONSET_S + BLACKOUT_S + CLUSTER_S,
        ),
    ),
    Scenario(
        "stamps of one sensor 3 s ahead",
        f"{FUSIONCORE}, issue 73 and CHANGELOG.md",
        "the compass is stamped 3 s in the future for 20 s",
        "a runaway of about 10 m/s (mended in a later version)",
        "Times are since the onset. Theirs is the IMU that predicts. Here such readings are "
        "dropped: meanwhile the yaw comes from wheels and fixes, and is less certain.",
        recovers((fault("wrong_stamp", topic="compass", size=3.0, duration=20.0),)),
    ),
    Scenario(
        "clock 10 s back",
        f"{RL}, issue 333 and src/ros_filter.cpp; introlab/rtabmap_ros, pull request 1333",
        "the clock of the robot's computer is set back by 10 s, for all of its nodes",
        "robot_localization ignores each message that is older than the last one of its topic; "
        "reset_on_time_jump is off by default, and commented out in the ROS 2 branch (commit "
        "1cb9533). rtabmap_ros did not update for those 10 s before it was mended",
        "The pose is forgotten and starts anew from fix and compass; what was learned stays.",
        recovers((fault("clock_jump", size=-10.0),), own_clock=True),
    ),
    Scenario(
        "NaN covariances, used",
        f"{RL}, issue 952",
        "the fixes' covariance is NaN for 20 s; lrf_use_message_covariance",
        "the output is NaN, and an error is logged, which suspects badly conditioned covariances; "
        "the issue does not show them",
        "Such fixes are refused: until the right ones it is dead reckoning with a compass, with "
        "errors that grow.",
        recovers(
            localizer=USED, since_s=ONSET_S + 20.0,
            spoil=fix_variance(math.nan, PLANE, ONSET_S, ONSET_S + 20.0),
        ),
    ),
)  # fmt: skip
"""Scenarios with something to recover from."""

EQUALITIES = (
    Scenario(
        "replay",
        f"{ARDUPILOT}/Replay/check_replay.py",
        "a run with late and reordered messages, and `replay` of what `simulate` records of it",
        "all fields of the logged EKF messages are equal; the number of messages may differ by 30",
        "The same localizer without a node; test/live/test_same_result.py compares a node's run "
        "with its replay.",
        lambda seed: equal.replayed(
            seed,
            (
                fault("delay", 10.0, topic="lrf_pose", size=0.7, rate=0.5),
                fault("reordered", 20.0, topic="compass"),
            ),
        ),
    ),
    Scenario(
        "all fixes 2 s late",
        f"{RL}, issue 911",
        "every fix comes 2 s late; compared with the same run in time",
        "no figure; smooth_lagged_data is off and history_length is 0 by default",
        "The pose is published before the fixes of its last 2 s are there: this is the price of a "
        "pose in time.",
        lambda seed: equal.undisturbed(
            seed, (fault("delay", 0.0, topic="lrf_pose", size=LATE_S),)
        ),
    ),
    Scenario(
        "all fixes 2 s late, waited for",
        f"{RL}, issue 911",
        "the same with history 4 s and output_delay 2.5 s",
        "issue 262 asked for odom that waits; pull request 266 keeps a history instead",
        "Two parameters differ from the defaults; odom is 2.5 s old.",
        lambda seed: equal.undisturbed(
            seed,
            (fault("delay", 0.0, topic="lrf_pose", size=LATE_S),),
            history=4.0, output_delay=NO_DELAY_S,
        ),
    ),
    Scenario(
        "NaN covariances, not used",
        f"{RL}, issue 952",
        "the fixes' covariance is NaN from the start; compared with a run without",
        "the output is NaN, and an error is logged, which suspects badly conditioned covariances; "
        "the issue does not show them",
        "By default the covariances of messages are not read.",
        lambda seed: equal.undisturbed(
            seed, spoil=fix_variance(math.nan, PLANE, 0.0, equal.DURATION_S)
        ),
    ),
    Scenario(
        "largest double as variance",
        "yujinrobot/kobuki, issue 383",
        "1.8e308 as variance of z, roll and pitch; lrf_use_message_covariance",
        "all of robot_localization's output becomes NaN; kobuki now sends 1e10 (pull request 387)",
        "Only x, y and yaw are read.",
        lambda seed: equal.undisturbed(
            seed, spoil=fix_variance(LARGEST_DOUBLE, REST, 0.0, equal.DURATION_S), **USED
        ),
    ),
    Scenario(
        "a recording in a loop",
        f"{RL}, issue 163; locusrobotics/fuse, issue 260",
        "60 s that play twice with their clock; the second lap compared with the first, from 5 s "
        "to 55 s of it",
        "robot_localization discards the second lap as old; fuse ignores what is 40.9 s too old",
        "Not 0: the second lap begins with the noise that the first one has learned.",
        equal.looped,
    ),
)  # fmt: skip
"""Scenarios with a run that another one should equal."""
