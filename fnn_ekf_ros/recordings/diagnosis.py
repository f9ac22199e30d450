# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""What is in a recording, and what is wrong with robot, wiring or configuration."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

from fnn_ekf_ros import messages
from fnn_ekf_ros.calibration.examination import Drive, Examined, examine
from fnn_ekf_ros.calibration.findings import Certainty, Change, Finding, in_order
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import ParameterError, build, fields_of
from fnn_ekf_ros.recordings.bag_facts import FactsCollector, TopicFacts, by_name
from fnn_ekf_ros.recordings.bag_files import BagReader, Record
from fnn_ekf_ros.recordings.drive_readings import DriveReadings, clock_findings
from fnn_ekf_ros.recordings.input_plan import InputPlan, plan_inputs
from fnn_ekf_ros.recordings.inputs import TopicNames, inputs_in

LENGTHS = ("wheel_radius", "wheel_separation")
"""Parameters that must be set, and that a user may give in another unit [m]."""
PLACEHOLDER = {
    "wheel_radius": 0.05,
    "wheel_separation": 0.3,
    "encoder_counts_per_revolution": 1000.0,
}
"""Values with which the examination begins where none is set (m, m, counts)."""


class Configured(NamedTuple):
    """The parameters that the examination goes by.

    Attributes:
        values: all of them, by name; lengths as they were given, in range or not.
        unset: names of those that are placeholders.
        findings: about parameters that cannot be used as they are.
    """

    values: dict[str, Any]
    unset: tuple[str, ...]
    findings: tuple[Finding, ...]


class Diagnosis(NamedTuple):
    """What was found out about a bag.

    Attributes:
        duration_s: of the recording [s].
        facts: of its topics.
        findings: what is wrong, the surest first.
        estimates: every number that could be estimated.
        obstacle: why `replay` would not work; empty if it would.
    """

    duration_s: float
    facts: tuple[TopicFacts, ...]
    findings: tuple[Finding, ...]
    estimates: tuple[Change, ...]
    obstacle: str


class BagExamination:
    """The examination of a bag.

    Args:
        bag: the recording.
        given: parameters as the user gave them.
        names: the localizer's topics, remapped.

    Raises:
        BagError: the bag cannot be read.
        ParameterError: a parameter is wrong in another way than missing or of another unit.
    """

    def __init__(self, bag: BagReader, given: Mapping[str, Any], names: TopicNames) -> None:
        self._bag, self._given, self._names = bag, given, names
        self._configured = configured_values(given)
        self._plan = plan_inputs(bag, self._configured.values, names)
        self._values = {**self._configured.values, "encoder_source": self._plan.source}
        self._collector = FactsCollector(bag)
        self._readings = DriveReadings(self._values)
        self._topics = {name: topic for topic, name in self._plan.topics.items()}

    def add(self, record: Record) -> None:
        """Take a record in."""
        self._collector.add(record)
        topic = self._topics.get(record.topic)
        if topic is not None:
            self._readings.take(topic, self._bag.message(record), record.time_ns)

    @property
    def configured(self) -> dict[str, Any]:
        """All parameters that the examination goes by."""
        return self._values

    def drive(self) -> Drive:
        """Return the readings, with the stamps of other clocks put right."""
        return self._readings.drive(self._clocks()[1])

    def diagnosis(self) -> Diagnosis:
        """Return what the records say."""
        plan, values, readings = self._plan, self._values, self._readings
        facts = by_name(self._collector.facts())
        clocks = self._clocks()[0]
        examined = examine(self.drive(), values)
        findings = in_order([
            *plan.findings,
            *self._configured.findings,
            *readings.joint_findings(),
            *clocks,
            *_edge_findings(plan, facts, values, readings),
            *_without_doubles(self._configured, examined.findings, clocks),
            *_unset(self._configured, values, examined),
        ])  # fmt: skip
        return Diagnosis(
            duration_s=self._bag.duration_s,
            facts=tuple(facts.values()),
            findings=findings,
            estimates=examined.estimates,
            obstacle=_obstacle(self._bag, self._given, self._names, findings),
        )

    def _clocks(self) -> tuple[list[Finding], dict[str, float]]:
        return clock_findings(self._plan, by_name(self._collector.facts()), self._values)


def configured_values(given: Mapping[str, Any]) -> Configured:
    """Return all parameters; what has to be set and is not becomes a placeholder.

    Raises:
        ParameterError: a value that is wrong in another way than missing or of another unit.
    """
    usable = dict(given)
    raw: dict[str, float] = {}
    findings = []
    unset = []
    specs = {name: spec for name, spec, _ in fields_of(LocalizerParameters)}
    for name in LENGTHS:
        value = given.get(name, 0.0)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if number and value == 0.0:
            unset.append(name)
            usable[name] = PLACEHOLDER[name]
        elif number and math.isfinite(value) and not (
            specs[name].at_least <= value <= specs[name].at_most
        ) and value > 0.0:  # fmt: skip
            raw[name] = float(value)
            usable[name] = PLACEHOLDER[name]
            findings.append(_out_of_range(name, float(value), specs[name].limits))
    ticks = given.get("encoder_source", "ticks") == "ticks"
    if ticks and not given.get("encoder_counts_per_revolution", 0.0):
        unset.append("encoder_counts_per_revolution")
        usable["encoder_counts_per_revolution"] = PLACEHOLDER["encoder_counts_per_revolution"]
    values = asdict(build(LocalizerParameters, usable)) | raw
    return Configured(values, tuple(unset), tuple(findings))


def _out_of_range(name: str, value: float, limits: str) -> Finding:
    return Finding(
        "not_set", f"{name} is {value:g}", f"expected meters, {limits}", Certainty.CERTAIN
    )


def _unset(configured: Configured, values: Mapping[str, Any], examined: Examined) -> list[Finding]:
    """Return the parameters that must be set, with what the drive says they are."""
    estimates = {change.parameter: change for change in examined.estimates}
    radius = estimates.get("wheel_radius")
    counts = "encoder_counts_per_revolution"
    found = []
    for name in configured.unset:
        if name == counts and values["encoder_source"] != "ticks":
            continue  # positions are in radians
        change = estimates.get(name)
        evidence = "the value that fits this drive" if radius else "measure it"
        if name == counts and "wheel_radius" in configured.unset:
            change = Change(name, PLACEHOLDER[name], unit="counts")
            evidence = "any value does where wheel_radius is made to fit"
        elif name == counts and radius is not None:
            change = _counts_for(float(configured.values["wheel_radius"]), radius)
        found.append(
            Finding(
                "not_set",
                f"{name} is not set",
                evidence,
                Certainty.CERTAIN,
                (change,) if change else (),
            )
        )
    return found


def _counts_for(wheel_radius: float, fitting: Change) -> Change:
    """Return the counts per revolution with which a radius fits, instead of the fitting radius."""
    name = "encoder_counts_per_revolution"
    value, low, high = (
        PLACEHOLDER[name] * wheel_radius / float(each)
        for each in (fitting.value, fitting.high, fitting.low)
    )
    return Change(name, value, low, high, "counts")


def _without_doubles(
    configured: Configured, findings: Sequence[Finding], clocks: Sequence[Finding]
) -> list[Finding]:
    """Return findings without those of another one's cause.

    These are delays of a sensor whose clock is wrong, and sizes that were placeholders.
    """
    known = {change.parameter for clock in clocks for change in clock.changes}
    unset = set(configured.unset)
    placeholders = set()
    if unset & {"wheel_radius", "encoder_counts_per_revolution"}:
        placeholders.add("meters_per_count")
    if "wheel_separation" in unset:
        placeholders.add("wheel_separation")
    return [
        finding
        for finding in findings
        if finding.name not in placeholders
        and not any(change.parameter in known for change in finding.changes)
    ]


def _edge_findings(
    plan: InputPlan,
    facts: Mapping[str, TopicFacts],
    values: Mapping[str, Any],
    readings: DriveReadings,
) -> list[Finding]:
    """Return what the localizer would refuse of messages that are there."""
    found = []
    fixes = plan.topics.get(messages.LRF_POSE)
    if fixes is not None:
        frames = facts[fixes].frames
        if frames and values["frame_id"] not in frames:
            found.append(
                Finding(
                    "frame",
                    f"the fixes are in frame '{frames[0]}', frame_id is '{values['frame_id']}'",
                    f"{facts[fixes].messages} messages of {fixes} would be refused",
                    Certainty.CERTAIN,
                    (Change("frame_id", frames[0]),),
                )
            )
    compass = plan.topics.get(messages.COMPASS)
    usable = readings.fixes_have_yaw
    if (compass is None or facts[compass].messages == 0) and usable and not values["lrf_use_yaw"]:
        found.append(
            Finding(
                "no_yaw",
                "there is no compass, and the yaw of the fixes is not used",
                "the fixes have a yaw",
                Certainty.CERTAIN,
                (Change("lrf_use_yaw", value=True),),
            )
        )
    return found


def _obstacle(
    bag: BagReader, given: Mapping[str, Any], names: TopicNames, findings: Sequence[Finding]
) -> str:
    """Return why `replay` would not work with what was given; empty if it would."""
    try:
        parameters = build(LocalizerParameters, dict(given))
        inputs_in(bag, parameters, names)
    except (ParameterError, FnnEkfError) as error:
        return str(error)
    for finding in findings:
        if finding.name in ("frame", "no_yaw", "missing_topic", "joint_names"):
            return finding.sentence
    return ""
