"""Membership function files, read and written; the packaged ones are named without a path."""

import reprlib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from fnn_ekf_ros.core.adaptation import FuzzyNetwork, Networks
from fnn_ekf_ros.core.fuzzy import FuzzySets
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.localizer import SAME_FILE, LocalizerParameters
from fnn_ekf_ros.parameters.schema import finite_number
from fnn_ekf_ros.text_files import read_text, write_text
from fnn_ekf_ros.yaml_text import load_yaml

FORMAT_VERSION = 1
PACKAGED = ("initial", "published", "trained", "joint_initial", "joint")
SMALLEST, LARGEST = 1e-15, 1e15
"""Sizes of numbers that leave room for products of them."""
REMEDY = "write it again with `train --out`"
_POSITIVE = ("position_unit", "yaw_unit", "change_limit")
LETTERS = ("a1", "b1", "a2", "b2", "a3", "b3", "a4", "b4", "c1", "sigma1", "c2", "sigma2")
"""The paper's names of the parameters, in the order of `FuzzySets`."""
_HEAD = """\
# Membership functions of fnn_ekf_ros; x = {argument}. P, N, I, D: sigmoids
# 1/(1+exp(-slope*(x-center))); Z, M: Gaussians exp(-(x-center)^2/(2*width^2)).
"""
MISMATCH = "C_hat - S in the units below"
"""Argument of the paper's sets."""
EXPLAINED = "u in log variance"
"""Argument of mode joint's sets: what the evidence asks for. They have no unit."""


class MembershipError(FnnEkfError):
    """A membership file that cannot be read or does not make sense."""


def networks_for(parameters: LocalizerParameters) -> Networks:
    """Return the membership functions that a localizer is told to use.

    Those of all modes: a wrong name is refused in every mode.

    Raises:
        MembershipError: no such set or file, or a broken one.
    """
    measurement = _of_the_paper("membership_file", parameters.membership_file)
    process = measurement
    if parameters.process_membership_file != SAME_FILE:
        process = _of_the_paper("process_membership_file", parameters.process_membership_file)
    joint = read_membership(parameters.joint_membership_file, "joint_membership_file")
    if not _without_unit(joint):
        raise MembershipError(
            f"joint_membership_file '{parameters.joint_membership_file}' has units other than 1, "
            "as sets of the modes r, q and rq have: give it as membership_file"
        )
    return Networks(measurement, process, joint)


def _of_the_paper(parameter: str, name: str) -> FuzzyNetwork:
    network = read_membership(name, parameter)
    if _without_unit(network):
        raise MembershipError(
            f"{parameter} '{name}' has units of 1, as sets of mode joint have: give it as "
            "joint_membership_file"
        )
    return network


def _without_unit(network: FuzzyNetwork) -> bool:
    """Return whether the functions are of what evidence asks for, which has no unit."""
    return network.position_unit == 1.0 and network.yaw_unit == 1.0


def read_membership(name: str, parameter: str = "membership_file") -> FuzzyNetwork:
    """Return the membership functions of a packaged set or of a user's file.

    Args:
        name: one of `PACKAGED`, or a path.
        parameter: what names it, for refusals.

    Raises:
        MembershipError: no such set or file, or a broken one.
    """
    label = f"{parameter} '{name}'"
    if name in PACKAGED:
        text = (resources.files(__package__) / f"{name}.yaml").read_text(encoding="utf-8")
    else:
        try:
            text = read_text(Path(name), parameter, MembershipError)
        except MembershipError as error:
            raise MembershipError(
                f"{error}; expected one of {', '.join(PACKAGED)}, or the path of a file"
            ) from None
    try:
        content = load_yaml(text, label, MembershipError)
    except MembershipError as error:
        raise MembershipError(f"{error}; mend or {REMEDY}") from None
    return _network(label, content)


def write_membership(
    path: Path, network: FuzzyNetwork, notes: Sequence[str], argument: str = MISMATCH
) -> None:
    """Write a membership file, completely or not at all.

    Args:
        path: the file.
        network: membership functions with their units.
        notes: lines on where they come from.
        argument: what the functions are functions of, `MISMATCH` or `EXPLAINED`.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    write_text(path, render_membership(network, notes, argument))


def render_membership(network: FuzzyNetwork, notes: Sequence[str], argument: str = MISMATCH) -> str:
    """Return the text of a membership file; what is read from it is equal bit for bit.

    The version comes last: a file that was cut short has none and is refused.

    Args:
        network: membership functions with their units.
        notes: lines on where they come from.
        argument: what the functions are functions of, `MISMATCH` or `EXPLAINED`.
    """
    without_unit = argument == EXPLAINED
    meanings = (
        "" if without_unit else "m^2, of position variances",
        "" if without_unit else "rad^2, of yaw variances",
        "half width of the universe of the change, for centroid only",
    )
    entries = [
        (f"{key}: {getattr(network, key)!r}", meaning)
        for key, meaning in zip(_POSITIVE, meanings, strict=True)
    ]
    entries.append(("sets:", ""))
    entries += [
        (f"  {key}: {value!r}", letter)
        for (key, value), letter in zip(network.sets._asdict().items(), LETTERS, strict=True)
    ]
    width = max(len(entry) for entry, _ in entries)
    lines = [f"# {note}" for note in notes]
    lines += [f"{entry:<{width}} # {said}" if said else entry for entry, said in entries]
    lines.append(f"version: {FORMAT_VERSION}")
    return _HEAD.format(argument=argument) + "\n".join(lines) + "\n"


def _network(label: str, content: Any) -> FuzzyNetwork:
    if not isinstance(content, dict) or "version" not in content:
        raise MembershipError(
            f"{label} has no version: it was cut short or is of another kind; {REMEDY}"
        )
    version = content["version"]
    if type(version) is not int or version != FORMAT_VERSION:
        newer = type(version) is int and version > FORMAT_VERSION
        remedy = "update fnn_ekf_ros, or " if newer else ""
        raise MembershipError(
            f"{label} has version {reprlib.repr(version)}: expected "
            f"{FORMAT_VERSION}; {remedy}{REMEDY}"
        )
    _check_keys(label, content, {"version", "sets", *_POSITIVE})
    if not isinstance(content["sets"], dict):
        raise MembershipError(f"{label}: expected 'sets' to hold parameters")
    _check_keys(label, content["sets"], set(FuzzySets._fields))
    values = {key: _number(label, key, content["sets"][key]) for key in FuzzySets._fields}
    units = {key: _number(label, key, content[key]) for key in _POSITIVE}
    for key, value in {**units, "zero_width": values["zero_width"]}.items():
        if value <= 0.0:
            raise MembershipError(f"{label}: {key} is {value:g}: expected more than 0")
    if values["increase_slope"] == 0.0:
        raise MembershipError(f"{label}: increase_slope is 0: it must not be")
    if values["maintain_width"] < 0.0:
        raise MembershipError(
            f"{label}: maintain_width is {values['maintain_width']:g}: expected at least 0"
        )
    return FuzzyNetwork(FuzzySets(**values), **units)


def _check_keys(label: str, content: dict[Any, Any], expected: set[str]) -> None:
    for word, keys in (
        ("lacks", expected - content.keys()),
        ("has unknown", content.keys() - expected),
    ):
        if keys:
            listed = ", ".join(sorted(map(str, keys)))
            raise MembershipError(f"{label} {word} {listed}; mend or {REMEDY}")


def _number(label: str, key: str, value: Any) -> float:
    number = finite_number(value)
    if number is None or (number != 0.0 and not SMALLEST <= abs(number) <= LARGEST):
        raise MembershipError(
            f"{label}: {key} is {reprlib.repr(value)}: expected a number, 0 or "
            f"between {SMALLEST:g} and {LARGEST:g} in size"
        )
    return number
