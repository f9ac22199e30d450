# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""`doctor BAG`: what is in a recording, and what is wrong with robot, wiring or configuration."""

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from fnn_ekf_ros import messages
from fnn_ekf_ros.calibration.examination import Examined, examine
from fnn_ekf_ros.calibration.findings import Certainty, Change, Finding, in_order
from fnn_ekf_ros.commands.arguments import (
    add_parameter_arguments,
    add_remapping_argument,
    given_parameters,
)
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import write_json, write_text
from fnn_ekf_ros.parameters.files import render_parameter_file
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import ParameterError, build, fields_of
from fnn_ekf_ros.recordings.bag_facts import FactsCollector, TopicFacts, by_name
from fnn_ekf_ros.recordings.bag_files import BagReader
from fnn_ekf_ros.recordings.drive_readings import DriveCollector, clock_findings
from fnn_ekf_ros.recordings.input_plan import InputPlan, plan_inputs
from fnn_ekf_ros.recordings.inputs import TopicNames, inputs_in
from fnn_ekf_ros.reports.doctor_report import as_json, as_text
from fnn_ekf_ros.reports.progress import with_progress
from fnn_ekf_ros.reports.result_folder import check_result_file

EXIT_CODE = (
    "The exit code is 0 if replay would work with these parameters and remappings, otherwise 1."
)
"""Last words of `--help`."""
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = EXIT_CODE
    parser.add_argument("bag", metavar="BAG", type=Path, help="the recording of a drive")
    add_parameter_arguments(parser)
    add_remapping_argument(parser)
    parser.add_argument("--json", metavar="FILE", type=Path, help="write everything as JSON")
    parser.add_argument(
        "--write-params", metavar="FILE", type=Path,
        help="write the parameters with what is certain or likely put right, ready to run",
    )  # fmt: skip


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


def run(arguments: argparse.Namespace) -> int:
    """Run the command."""
    given = given_parameters(arguments, NODE_NAME)
    names = TopicNames(arguments.remappings)
    taken = [arguments.bag, *arguments.params]
    for option, path in (("--json", arguments.json), ("--write-params", arguments.write_params)):
        if path is not None:
            check_result_file(option, path, taken)
            taken.append(path)
    _, facts, findings, estimates, obstacle = found = diagnose(arguments.bag, given, names)
    print(as_text(arguments.bag, found.duration_s, facts, findings, obstacle))
    if arguments.json is not None:
        write_json(arguments.json, as_json(facts, findings, estimates, obstacle))
    if arguments.write_params is not None:
        text = corrected_file(arguments.bag.name, given, findings)
        write_text(arguments.write_params, text)
        print(f"{arguments.write_params}: parameters with these corrections")
    return 1 if obstacle else 0


def diagnose(path: Path, given: Mapping[str, Any], names: TopicNames) -> Diagnosis:
    """Return what is in a bag and what is wrong.

    Args:
        path: of the bag.
        given: parameters as the user gave them.
        names: the localizer's topics, remapped.

    Raises:
        BagError: the bag cannot be read.
        ParameterError: a parameter is wrong in another way than missing or of another unit.
    """
    configured = configured_values(given)
    with BagReader(path) as bag:
        plan = plan_inputs(bag, configured.values, names)
        collector = FactsCollector(bag)
        values = {**configured.values, "encoder_source": plan.source}
        readings = DriveCollector(bag, plan, values)
        for record in with_progress(bag.records(), bag.message_count, "doctor"):
            collector.add(record)
            readings.add(record)
        facts = by_name(collector.facts())
        clocks, skews = clock_findings(plan, facts, values)
        examined = examine(readings.drive(skews), values)
        findings = in_order([
            *plan.findings,
            *configured.findings,
            *readings.joint_findings(),
            *clocks,
            *_edge_findings(plan, facts, values, readings),
            *_without_doubles(configured, examined.findings, clocks),
            *_unset(configured, values, examined),
        ])  # fmt: skip
        return Diagnosis(
            duration_s=bag.duration_s,
            facts=tuple(facts.values()),
            findings=findings,
            estimates=examined.estimates,
            obstacle=_obstacle(bag, given, names, findings),
        )


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


def corrected_values(given: Mapping[str, Any], findings: Sequence[Finding]) -> LocalizerParameters:
    """Return parameters with what is certain or likely put right.

    Raises:
        ParameterError: they still cannot be used.
    """
    values = dict(given)
    known = {name for name, _, _ in fields_of(LocalizerParameters)}
    for finding in reversed(findings):  # the surest wins
        if finding.certainty is Certainty.POSSIBLE:
            continue
        for change in finding.changes:
            if change.parameter in known:
                values[change.parameter] = change.value
    return build(LocalizerParameters, values)


def corrected_file(bag: str, given: Mapping[str, Any], findings: Sequence[Finding]) -> str:
    """Return a parameter file with what is certain or likely put right.

    Raises:
        ParameterError: the parameters still cannot be used.
    """
    head = f"Localizer parameters after `doctor {bag}`."
    remaps = sorted({remap for each in findings for remap in each.remaps})
    if remaps:
        head += "\nRun with " + " ".join(f"-r {remap}" for remap in remaps)
    corrected = asdict(corrected_values(given, findings))
    return render_parameter_file(LocalizerParameters, corrected, NODE_NAME, head)


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
    readings: DriveCollector,
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
