# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameter sets as frozen dataclasses that validate themselves.

A field carries its default and a `Spec`: unit, limits, the sentence for the user. From it come
the checks, the YAML files, the ROS descriptors and the documentation; nothing is written twice.
"""

import dataclasses
import math
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.fields import as_number, suggestion

ALWAYS_ALLOWED = ("use_sim_time", "start_type_description_service")
"""Parameters that every ROS node has; `qos_overrides.*` is allowed as well."""

NO_FILE = "none"
"""Value of a file parameter for no file."""

ParameterValue = bool | int | float | str | tuple[float, ...]
"""Value of a parameter."""
ParametersT = TypeVar("ParametersT", bound="Parameters")
"""A dataclass of parameters."""


class ParameterError(FnnEkfError):
    """A parameter that is unknown, of the wrong type or out of its range."""


@dataclass(frozen=True, slots=True)
class Spec:
    """Description of one parameter, without its default.

    Attributes:
        doc: one sentence for the user.
        unit: unit of a number, or of each entry of a list.
        at_least: smallest value (of each entry of a list).
        at_most: largest value.
        choices: the words a string may be; empty for any.
        required: the default stands for "not set" and is no valid value.
        may_be_nan: NaN stands for "not set" and is valid.
        at_run_time: it may be changed while the node runs.
    """

    doc: str
    unit: str = ""
    at_least: float = -math.inf
    at_most: float = math.inf
    choices: tuple[str, ...] = ()
    required: bool = False
    may_be_nan: bool = False
    at_run_time: bool = False

    @property
    def limits(self) -> str:
        """The allowed range in words; empty if there is none."""
        if self.at_least == -math.inf and self.at_most == math.inf:
            return ""
        return f"from {self.at_least:.10g} to {self.at_most:.10g}"


def parameter(default: ParameterValue, doc: str, unit: str = "", **limits: Any) -> Any:
    """Return a dataclass field with a `Spec`; `limits` are the Spec's other attributes."""
    spec = Spec(doc, unit, **limits)
    return dataclasses.field(default=default, metadata={"spec": spec})


@dataclass(frozen=True, slots=True)
class Parameters:
    """Base of the parameter sets: checks every field against its `Spec` when it is made."""

    def __post_init__(self) -> None:
        """Check and normalize the fields (an integer where a float belongs becomes a float).

        Raises:
            ParameterError: a value has the wrong type or is out of range.
        """
        for name, spec, default in fields_of(type(self)):
            object.__setattr__(self, name, _checked(name, spec, default, getattr(self, name)))
        self.check()

    def check(self) -> None:
        """Check what concerns several parameters at once; sets override it."""


def fields_of(kind: type[Parameters]) -> list[tuple[str, Spec, ParameterValue]]:
    """Return name, spec and default of each parameter of a set, in order."""
    return [
        (f.name, f.metadata["spec"], f.default)  # type: ignore[misc]
        for f in dataclasses.fields(kind)
    ]


def default_of(kind: type[Parameters], name: str) -> Any:
    """Return the default of one parameter of a set."""
    return {field: default for field, _, default in fields_of(kind)}[name]


def build(kind: type[ParametersT], values: Mapping[str, Any]) -> ParametersT:
    """Return a parameter set from names and values as a user gave them.

    Args:
        kind: the set.
        values: values by name; what is left out keeps its default. The names that every ROS
            node knows are passed over.

    Raises:
        ParameterError: an unknown name, a wrong type, a value out of range.
    """
    known = [name for name, _, _ in fields_of(kind)]
    for name in values:
        if name in ALWAYS_ALLOWED and not isinstance(values[name], bool):
            raise refusal(name, values[name], "true or false")
        if name not in known and not is_always_allowed(name):
            raise ParameterError(f"unknown parameter '{name}'{suggestion(name, known)}")
    return kind(**{name: value for name, value in values.items() if name in known})


def is_always_allowed(name: str) -> bool:
    """Return whether every ROS node accepts the parameter."""
    return name in ALWAYS_ALLOWED or name.startswith("qos_overrides.")


def refusal(name: str, value: object, expected: str) -> ParameterError:
    """Return the error for a parameter: its name, the value, what was expected instead."""
    shown = reprlib.repr(list(value) if isinstance(value, tuple) else value)
    return ParameterError(f"parameter '{name}' is {shown}: expected {expected}")


def _checked(name: str, spec: Spec, default: ParameterValue, value: Any) -> ParameterValue:
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise refusal(name, value, "true or false")
        return value
    if isinstance(default, str):
        return _checked_word(name, spec, value)
    if isinstance(default, tuple):
        return _checked_list(name, spec, len(default), value)
    return _checked_number(name, spec, value, whole=isinstance(default, int))


def _checked_word(name: str, spec: Spec, value: Any) -> str:
    expected = f"one of {', '.join(spec.choices)}" if spec.choices else "a non-empty string"
    if not isinstance(value, str):
        hint = " (a bare off, no, on or yes is a truth value in YAML)"
        raise refusal(name, value, expected + (hint if isinstance(value, bool) else ""))
    if not value.isprintable() or value == "" or (spec.choices and value not in spec.choices):
        raise refusal(name, value, expected)
    return str(value)


def _checked_list(name: str, spec: Spec, length: int, value: Any) -> tuple[float, ...]:
    expected = f"a list of {length} numbers" + (f" {spec.unit}" if spec.unit else "")
    if not isinstance(value, list | tuple) or len(value) != length:
        raise refusal(name, value, expected)
    numbers = [as_number(entry) for entry in value]
    if any(number is None for number in numbers):
        raise refusal(name, value, expected)
    checked = tuple(float(number) for number in numbers if number is not None)
    if spec.may_be_nan and any(math.isnan(number) for number in checked):
        if not all(math.isnan(number) for number in checked):
            raise refusal(name, checked, f"{expected}, or all .nan for 'not set'")
        return checked
    if not all(_inside(spec, number) for number in checked):
        raise refusal(name, checked, f"{expected}, each {spec.limits or 'finite'}")
    return checked


def _checked_number(name: str, spec: Spec, value: Any, *, whole: bool) -> int | float:
    kind = "a whole number" if whole else "a number"
    expected = " ".join(filter(None, [kind, spec.limits, f"[{spec.unit}]" if spec.unit else ""]))
    number = as_number(value)
    if number is None or (whole and not number.is_integer()):
        raise refusal(name, value, expected)
    if not _inside(spec, number):
        if spec.required and number == 0.0:
            raise ParameterError(
                f"parameter '{name}' is not set: expected {expected}; it is the "
                f"{spec.doc[0].lower()}{spec.doc[1:].rstrip('.')}"
            )
        raise refusal(name, value, expected)
    return int(number) if whole else float(number)


def _inside(spec: Spec, number: float) -> bool:
    return math.isfinite(number) and spec.at_least <= number <= spec.at_most
