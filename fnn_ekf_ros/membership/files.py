"""Reading of membership function files; the packaged ones are named without a path."""

import math
from importlib import resources
from pathlib import Path
from typing import Any

import yaml

from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.core.fuzzy import FuzzySets
from fnn_ekf_ros.errors import FnnEkfError

FORMAT_VERSION = 1
PACKAGED = ("initial", "published")
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
            text = Path(name).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "not a text file"
            raise MembershipError(
                f"membership_file '{name}': {reason}; expected one of "
                f"{', '.join(PACKAGED)}, or the path of a file"
            ) from None
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise MembershipError(f"membership_file '{name}' is not YAML: {reason}") from None
    return _network(name, content)


def _network(name: str, content: Any) -> FuzzyNetwork:
    if not isinstance(content, dict) or content.get("version") != FORMAT_VERSION:
        found = content.get("version") if isinstance(content, dict) else None
        raise MembershipError(
            f"membership_file '{name}' has version {found}: expected {FORMAT_VERSION}"
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
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise MembershipError(
            f"membership_file '{name}': {key} is {value!r}: expected a finite number"
        )
    return float(value)
