# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reading and writing of membership function files; packaged ones are named without a path."""

from collections.abc import Sequence
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

from fnn_ekf_ros.core.adaptation import FuzzyNetwork, Networks
from fnn_ekf_ros.core.fuzzy import FuzzySets
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.fields import Fields
from fnn_ekf_ros.files.text_files import read_text
from fnn_ekf_ros.files.yaml_text import load_yaml
from fnn_ekf_ros.parameters.localizer import SAME_FILE, LocalizerParameters

FORMAT_VERSION = 1
"""Version of the file format that is written and read."""
PACKAGED = ("initial", "published", "trained", "joint_initial", "joint")
"""Names of the packaged files."""
SMALLEST, LARGEST = 1e-15, 1e15
"""Sizes of numbers whose products double precision can hold."""
_SIZE = f"a number, 0 or between {SMALLEST:g} and {LARGEST:g} in size"
"""Condition on a number of a file, in words."""
REMEDY = "write it again with `train --out`"
"""Advice in the messages of refusals."""
_POSITIVE = ("position_unit", "yaw_unit", "change_limit")
"""Keys of the file beside the sets, in the order in which they are written; all more than 0."""
LETTERS = ("a1", "b1", "a2", "b2", "a3", "b3", "a4", "b4", "c1", "sigma1", "c2", "sigma2")
"""The paper's names of the parameters, in the order of `FuzzySets`."""
_HEAD = """\
# Membership functions of fnn_ekf_ros; x = {argument}. P, N, I, D: sigmoids
# 1/(1+exp(-slope*(x-center))); Z, M: Gaussians exp(-(x-center)^2/(2*width^2)).
"""
"""Comment at the top of a file."""
MISMATCH = "C_hat - S in the units below"
"""Argument of the paper's sets, as the head of a file names it."""
EXPLAINED = "u in log variance"
"""Argument of mode joint's sets, likewise; a log variance has no unit."""


class MembershipError(FnnEkfError):
    """A membership file that cannot be read or is not valid."""


def networks_for(parameters: LocalizerParameters) -> Networks:
    """Return the membership functions of a localizer's parameters.

    Those of all modes are read, so that a wrong name is refused in every mode.

    Raises:
        MembershipError: a set or file does not exist or is not valid.
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
    return Networks(measurement=measurement, process=process, joint=joint)


def _of_the_paper(parameter: str, name: str) -> FuzzyNetwork:
    network = read_membership(name, parameter)
    if _without_unit(network):
        raise MembershipError(
            f"{parameter} '{name}' has units of 1, as sets of mode joint have: give it as "
            "joint_membership_file"
        )
    return network


def _without_unit(network: FuzzyNetwork) -> bool:
    """Return whether the functions are of u, a log variance, which has no unit."""
    return network.position_unit == 1.0 and network.yaw_unit == 1.0


def read_membership(name: str, parameter: str = "membership_file") -> FuzzyNetwork:
    """Return the membership functions of a packaged set or of a user's file.

    Args:
        name: one of `PACKAGED`, or a path.
        parameter: the parameter that has the name, for refusals.

    Raises:
        MembershipError: the set or file does not exist or is not valid.
    """
    if name in PACKAGED:
        return _packaged(name)
    expected = f"one of {', '.join(PACKAGED)}, or the path of a file"
    text = read_text(Path(name), parameter, MembershipError, expected)
    return _read(text, f"{parameter} '{name}'")


@lru_cache(maxsize=len(PACKAGED))
def _packaged(name: str) -> FuzzyNetwork:
    """Return a packaged set; a study asks for it with every filter that it makes."""
    text = (resources.files(__package__) / f"{name}.yaml").read_text(encoding="utf-8")
    return _read(text, f"packaged set '{name}'")


def _read(text: str, label: str) -> FuzzyNetwork:
    """Return the membership functions of a file's text; refusals begin with the label."""
    try:
        content = load_yaml(text, label, MembershipError)
    except MembershipError as error:
        raise MembershipError(f"{error}; mend or {REMEDY}") from None
    return _network(label, content)


def render_membership(network: FuzzyNetwork, notes: Sequence[str], argument: str = MISMATCH) -> str:
    """Return the text of a membership file; reading it gives the same numbers bit for bit.

    The version comes last, so that a truncated file has none and is refused.

    Args:
        network: membership functions with their units.
        notes: lines on their origin.
        argument: argument of the functions, `MISMATCH` or `EXPLAINED`.
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
    fields = Fields(content, label, MembershipError, "membership functions", f"mend or {REMEDY}")
    fields.version("version", FORMAT_VERSION)
    keys = ("version", "sets", *_POSITIVE)
    fields.check_keys(keys, dict.fromkeys(keys, "all of a membership file"))
    sets = fields.section("sets", "the parameters of the sets")
    sets.check_keys(FuzzySets._fields, dict.fromkeys(FuzzySets._fields, _SIZE))
    values = {key: _number(sets, key) for key in FuzzySets._fields}
    units = {key: _number(fields, key) for key in _POSITIVE}
    for holder, key, number in (
        *((fields, key, units[key]) for key in _POSITIVE),
        (sets, "zero_width", values["zero_width"]),
    ):
        if number <= 0.0:
            raise holder.refusal(key, "more than 0")
    if values["increase_slope"] == 0.0:
        raise sets.refusal("increase_slope", "another number than 0")
    if values["maintain_width"] < 0.0:
        raise sets.refusal("maintain_width", "at least 0")
    return FuzzyNetwork(FuzzySets(**values), **units)


def _number(fields: Fields, key: str) -> float:
    return fields.number(key, _SIZE, lambda n: n == 0.0 or SMALLEST <= abs(n) <= LARGEST)
