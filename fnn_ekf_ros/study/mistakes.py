# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Mistakes of robot, wiring or configuration, of robots that are simulated or recorded."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

from fnn_ekf_ros.calibration.findings import Finding
from fnn_ekf_ros.messages.names import LEFT_TICKS, RIGHT_TICKS
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.faults import Bias, Delay, Fault, UnequalWheels, WrongStamp, WrongUnit
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.matching import matching_localizer
from fnn_ekf_ros.parameters.paper import SIMULATION_2_STD
from fnn_ekf_ros.parameters.schema import build

SLIPS = {"0.5 cm, 0.3 deg": (0.005, 0.005), "5 cm, 3 deg": SIMULATION_2_STD}
"""Slip of the robots, per 375 ms (m, rad): of good ground, and of the paper's simulation 2."""
NOTHING = "nothing"
"""Name of the runs without a mistake."""
C, L = "compass", "lrf_pose"
"""Topics of the compass and of the fixes."""
RIGHT_OVER_LEFT = "right_over_left"
"""Name of the ratio of what both wheels travel per count, the right one's first."""
LATE_S = 0.5
"""Latency of the sensors that stamp their messages on arrival [s]."""


class Mistake(NamedTuple):
    """A mistake that is there from the start.

    Attributes:
        name: in tables and on the command line.
        about: what it is.
        parameters: those that put it right; any one of them counts. Empty: none can.
        sensor: status that has to say it.
        factors: of parameters of the localizer.
        given: other parameters of the localizer.
        faults: of the robot's messages.
        swapped: whether left and right ticks are exchanged.
        findings: names of the findings of `doctor` that are right, where no parameter is.
    """

    name: str
    about: str
    parameters: tuple[str, ...]
    sensor: str = "encoders"
    factors: Mapping[str, float] = {}
    given: Mapping[str, Any] = {}
    faults: tuple[Fault, ...] = ()
    swapped: bool = False
    findings: tuple[str, ...] = ()

    def is_found(self, finding: Finding) -> bool:
        """Return whether a finding of `doctor` names the mistake."""
        changed = {change.parameter for change in finding.changes}
        return finding.name in self.findings or bool(changed & set(self.parameters))

    def topic(self, name: str) -> str:
        """Return the localizer's topic on which messages of one of the robot's arrive."""
        exchanged = {LEFT_TICKS: RIGHT_TICKS, RIGHT_TICKS: LEFT_TICKS}
        return exchanged.get(name, name) if self.swapped else name

    def configured(self, right: Mapping[str, Any]) -> dict[str, Any]:
        """Return the parameters of the localizer, from those that fit the robot."""
        changed = {name: right[name] * factor for name, factor in self.factors.items()}
        return {**right, **changed, **self.given}

    def effects(self) -> dict[str, tuple[float, float]]:
        """Return what faults do to right numbers: factor and what is added to the product.

        The number of unequal wheels is the ratio of what they travel per count, the right one's
        first; those of the others are parameters.
        """
        found: dict[str, tuple[float, float]] = {}
        turns = 1.0
        for fault in self.faults:
            if isinstance(fault, UnequalWheels):
                ratio = fault.factor if fault.wheel == "right" else 1.0 / fault.factor
                found[RIGHT_OVER_LEFT] = (ratio, 0.0)
            elif isinstance(fault, WrongUnit) and fault.topic == L:
                found["lrf_pose_scale"] = (1.0 / fault.factor, 0.0)
            elif isinstance(fault, WrongUnit):
                turns = math.copysign(1.0, fault.factor)
            elif isinstance(fault, Bias):
                name = "compass_offset" if fault.topic == C else "lrf_yaw_offset"
                found[name] = (turns, -turns * fault.size[2])
            elif isinstance(fault, WrongStamp):
                found[f"{fault.topic}_delay"] = (1.0, fault.size)
        return found

    def size(self, number: str) -> float:
        """Return what the mistake adds to a right number."""
        return self.effects()[number][1]


def _turned(angle: float) -> Bias:
    return Bias(start=0.0, topic=C, size=(0.0, 0.0, angle))


def _late(topic: str) -> tuple[Fault, ...]:
    return (
        Delay(start=0.0, topic=topic, size=LATE_S),
        WrongStamp(start=0.0, topic=topic, size=LATE_S),
    )


_SIZES = ("wheel_radius", "gear_ratio", "encoder_counts_per_revolution")
"""Parameters of which each one puts the distance per count right."""

MISTAKES: tuple[Mistake, ...] = (
    Mistake("counts_x4", "four times as many counts per revolution as configured", _SIZES,
            factors={"encoder_counts_per_revolution": 0.25}),
    Mistake("counts_/4", "a quarter of the configured counts per revolution", _SIZES,
            factors={"encoder_counts_per_revolution": 4.0}),
    Mistake("left_inverted", "the left counter runs backward", ("left_inverted",),
            given={"left_inverted": True}),
    Mistake("right_inverted", "the right counter runs backward", ("right_inverted",),
            given={"right_inverted": True}),
    Mistake("swapped", "left and right ticks are exchanged", (), swapped=True,
            findings=("wheels_swapped",)),
    Mistake("radius", "wheel_radius is 15 % too large", _SIZES, factors={"wheel_radius": 1.15}),
    Mistake("radius_cm", "wheel_radius in centimeters", _SIZES, factors={"wheel_radius": 100.0}),
    Mistake("separation", "wheel_separation is 30 % too large", ("wheel_separation",),
            factors={"wheel_separation": 1.3}),
    Mistake("separation_cm", "wheel_separation in centimeters", ("wheel_separation",),
            factors={"wheel_separation": 100.0}),
    Mistake("ratio", "the left wheel is 10 % smaller than the right one",
            ("left_wheel_radius_multiplier", "right_wheel_radius_multiplier"),
            faults=(UnequalWheels(start=0.0, wheel="left", factor=0.9),)),
    Mistake("gear_ratio", "a gear of 1 to 10 that is not configured", _SIZES,
            factors={"gear_ratio": 0.1}),
    Mistake("compass_ned", "the compass counts clockwise from north", ("compass_clockwise",), C,
            faults=(WrongUnit(start=0.0, topic=C, factor=-1.0), _turned(0.5 * math.pi))),
    Mistake("compass_mirrored", "the compass counts clockwise", ("compass_clockwise",), C,
            faults=(WrongUnit(start=0.0, topic=C, factor=-1.0),)),
    Mistake("compass_degrees", "degrees taken for radians", (), C,
            findings=("compass_degrees", "compass_random"),
            faults=(WrongUnit(start=0.0, topic=C, factor=180.0 / math.pi),)),
    Mistake("compass_radians", "radians taken for degrees", (), C,
            findings=("compass_degrees",),
            faults=(WrongUnit(start=0.0, topic=C, factor=math.pi / 180.0),)),
    Mistake("compass_offset", "the compass is off by 0.7 rad", ("compass_offset",), C,
            faults=(_turned(0.7),)),
    Mistake("fix_yaw", "the yaw of the fixes, which is used, is off by 0.6 rad",
            ("lrf_yaw_offset",), L, given={"lrf_use_yaw": True},
            faults=(Bias(start=0.0, topic=L, size=(0.0, 0.0, 0.6)),)),
    Mistake("fixes_mm", "fixes in millimeters", ("lrf_pose_scale",), L,
            faults=(WrongUnit(start=0.0, topic=L, factor=1000.0),)),
    Mistake("fixes_late", "fixes 0.5 s late and stamped on arrival", ("lrf_pose_delay",), L,
            faults=_late(L)),
    Mistake("compass_late", "the compass 0.5 s late and stamped on arrival", ("compass_delay",), C,
            faults=_late(C)),
)  # fmt: skip
"""Mistakes, with their sizes."""


def configured(
    given: Mapping[str, Any],
    robot: FakeRobotParameters | None = None,
    mistake: Mistake | None = None,
) -> LocalizerParameters:
    """Return the parameters of a robot's localizer.

    Args:
        given: those that the user chose.
        robot: None: the default one.
        mistake: None: there is none.

    Raises:
        ParameterError: a given one is wrong.
    """
    matching = asdict(matching_localizer(robot or FakeRobotParameters()))
    right = matching | {"process_noise_std": SIMULATION_2_STD} | dict(given)
    return build(LocalizerParameters, right if mistake is None else mistake.configured(right))
