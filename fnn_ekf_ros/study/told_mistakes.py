# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Simulated robots with a mistake: what the running localizer says, and what `doctor` says."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

from fnn_ekf_ros.diagnostics.messages import FITTING, MISTAKE, fitting_parameters
from fnn_ekf_ros.localizer.localizer import Localizer
from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.fake_robot import FakeRobotParameters
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.recordings.drive_readings import DriveReadings
from fnn_ekf_ros.simulation.listening import listen
from fnn_ekf_ros.study.diagnosed_mistakes import Diagnosed, diagnosed, true_numbers
from fnn_ekf_ros.study.fault_naming import START_NS, Report
from fnn_ekf_ros.study.mistakes import MISTAKES, Mistake, configured
from fnn_ekf_ros.timeline.events import Level, Status

IN_TIME_S = 60.0
"""Time of driving within which the running localizer has to name a mistake [s]."""


class Told(NamedTuple):
    """What the running localizer and `doctor` say of a mistake.

    Attributes:
        mistake: its name, or `NOTHING`.
        slip: of the robot, a key of `SLIPS`.
        seed: of the robot.
        named_s: time of driving from which on it is named, with its parameter, until the end; NaN:
            it is not [s].
        value: the parameter and the value to set by the last report.
        others: sensors that are not OK after that time.
        wrong: messages of other mistakes, at any time.
        warned: reports above OK, from when the filter runs.
        reports: number of all of them.
        doctor: what `doctor` says of the same drive.
    """

    mistake: str
    slip: str
    seed: int
    named_s: float
    value: str
    others: tuple[str, ...]
    wrong: tuple[str, ...]
    warned: int
    reports: int
    doctor: Diagnosed

    @property
    def in_time(self) -> bool:
        """Whether it was named in time and to the end."""
        return self.named_s <= IN_TIME_S


def follow_mistake(
    name: str, slip: str, robot: FakeRobotParameters, duration_s: float, given: Mapping[str, Any]
) -> Told:
    """Return what diagnostics say of a robot with a mistake, or with none.

    Args:
        name: of the mistake, or `NOTHING`.
        slip: of the robot, a key of `SLIPS`.
        robot: is driven.
        duration_s: length of the run [s].
        given: parameters of the localizer that the user chose.
    """
    mistake = next((each for each in MISTAKES if each.name == name), None)
    parameters = configured(given, robot, mistake)
    readings = DriveReadings(asdict(parameters))
    reports = list(_reports(mistake, robot, parameters, duration_s, readings))
    named_s, value, others, wrong = math.nan, "", set[str](), dict[str, None]()
    for report in reports:
        right = False
        for status in report.statuses:
            if not {MISTAKE, FITTING} & dict(status.values).keys():
                continue
            if mistake is not None and _is_named(mistake, status):
                right, value = True, dict(status.values).get(FITTING, "")
            else:
                wrong[status.message] = None
        if not right:
            named_s, others = math.nan, set()
        elif math.isnan(named_s):
            named_s = report.time_s
        if right and mistake is not None:
            others |= report.named() - {mistake.sensor}
    warned = sum(report.level > Level.OK for report in reports)
    return Told(
        name,
        slip,
        robot.seed,
        named_s,
        value,
        tuple(sorted(others)),
        tuple(wrong),
        warned,
        len(reports),
        diagnosed(mistake, readings.drive(), asdict(parameters), true_numbers(robot, mistake)),
    )


def _is_named(mistake: Mistake, status: Status) -> bool:
    named = set(fitting_parameters(status.values))
    expected = set(mistake.parameters)
    return status.name == mistake.sensor and (bool(named & expected) if expected else not named)


def _reports(
    mistake: Mistake | None,
    robot: FakeRobotParameters,
    parameters: LocalizerParameters,
    duration_s: float,
    readings: DriveReadings,
) -> Iterator[Report]:
    """Yield what diagnostics say, from when the filter runs; collect the readings."""
    localizer = Localizer(parameters, networks_for(parameters))
    faults = () if mistake is None else mistake.faults
    for heard in listen(robot, parameters, START_NS, duration_s, faults):
        topic = heard.topic if mistake is None else mistake.topic(heard.topic)
        readings.take(topic, heard.message, heard.now_ns)
        for output in localizer.receive(topic, heard.message, heard.now_ns).outputs:
            if output.statuses is not None and output.estimate is not None:
                yield Report((output.stamp_ns - START_NS) * 1e-9, output.statuses)
