"""Reading of membership function files; the packaged ones are named without a path."""

import reprlib
from importlib import resources
from pathlib import Path
from typing import Any

from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.core.fuzzy import FuzzySets
from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.schema import finite_number
from fnn_ekf_ros.text_files import read_text
from fnn_ekf_ros.yaml_text import load_yaml

FORMAT_VERSION = 1
PACKAGED = ("initial", "published")
SMALLEST, LARGEST = 1e-15, 1e15
"""Sizes of numbers that leave room for products of them."""
_POSITIVE = ("position_unit", "yaw_unit", "change_limit")


class MembershipError(FnnEkfError):
    """A membership file that cannot be read or does not make sense."""


def read_membership(name: str) -> FuzzyNetwork:
    """Return the membership functions of a packaged set or of a user's file.

    Args:
        name: one of `PACKAGED`, or a path.

    Raises:
        MembershipError: no such set or file, or a broken one.
    """
    if name in PACKAGED:
        text = (resources.files(__package__) / f"{name}.yaml").read_text(encoding="utf-8")
    else:
        try:
            text = read_text(Path(name), "membership_file", MembershipError)
        except MembershipError as error:
            raise MembershipError(
                f"{error}; expected one of {', '.join(PACKAGED)}, or the path of a file"
            ) from None
    content = load_yaml(text, f"membership_file '{name}'", MembershipError)
    return _network(name, content)


def _network(name: str, content: Any) -> FuzzyNetwork:
    if not isinstance(content, dict) or "version" not in content:
        raise MembershipError(f"membership_file '{name}' has no version: it is of another kind")
    version = content["version"]
    if type(version) is not int or version != FORMAT_VERSION:
        raise MembershipError(
            f"membership_file '{name}' has version {version!r}: expected {FORMAT_VERSION}"
        )
    _check_keys(name, content, {"version", "sets", *_POSITIVE})
    if not isinstance(content["sets"], dict):
        raise MembershipError(f"membership_file '{name}': expected 'sets' to hold parameters")
    _check_keys(name, content["sets"], set(FuzzySets._fields))
    values = {key: _number(name, key, content["sets"][key]) for key in FuzzySets._fields}
    units = {key: _number(name, key, content[key]) for key in _POSITIVE}
    for key, value in {**units, "zero_width": values["zero_width"]}.items():
        if value <= 0.0:
            raise MembershipError(
                f"membership_file '{name}': {key} is {value:g}: expected more than 0"
            )
    if values["increase_slope"] == 0.0:
        raise MembershipError(f"membership_file '{name}': increase_slope is 0: it must not be")
    if values["maintain_width"] < 0.0:
        raise MembershipError(
            f"membership_file '{name}': maintain_width is {values['maintain_width']:g}: "
            "expected at least 0"
        )
    return FuzzyNetwork(FuzzySets(**values), **units)


def _check_keys(name: str, content: dict[Any, Any], expected: set[str]) -> None:
    for word, keys in (
        ("lacks", expected - content.keys()),
        ("has unknown", content.keys() - expected),
    ):
        if keys:
            listed = ", ".join(sorted(map(str, keys)))
            raise MembershipError(f"membership_file '{name}' {word} {listed}")


def _number(name: str, key: str, value: Any) -> float:
    number = finite_number(value)
    if number is None or (number != 0.0 and not SMALLEST <= abs(number) <= LARGEST):
        raise MembershipError(
            f"membership_file '{name}': {key} is {reprlib.repr(value)}: expected a number, 0 or "
            f"between {SMALLEST:g} and {LARGEST:g} in size"
        )
    return number
