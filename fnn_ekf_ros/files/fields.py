# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Fields of what a YAML or JSON file holds, checked; every refusal has the same form."""

import math
import reprlib
from collections.abc import Callable, Collection, Mapping
from typing import Any

from fnn_ekf_ros.errors import FnnEkfError


class Fields:
    """A mapping that a file holds, read field by field.

    A refusal is one line: where, the key, its value, what was expected, and how to mend the file.

    Args:
        content: what the file holds.
        label: what holds the fields, such as `state_file 'x.yaml'`.
        kind: the error to raise.
        expected: what the content has to be, in words.
        remedy: how to mend the file; empty for none.

    Raises:
        FnnEkfError: the content is no mapping.
    """

    def __init__(
        self, content: Any, label: str, kind: type[FnnEkfError], expected: str, remedy: str = ""
    ) -> None:
        self.label = label
        self._kind, self._remedy = kind, remedy
        if not isinstance(content, Mapping):
            raise self._error(f"{label} holds {_shown(content)}: expected {expected}")
        self._content = content

    def __contains__(self, key: str) -> bool:
        return key in self._content

    def refusal(self, key: str, expected: str) -> FnnEkfError:
        """Return the error for a field: its value, or that it is missing, and what was expected."""
        found = f"is {_shown(self._content[key])}" if key in self._content else "is missing"
        return self._error(f"{self.label}: '{key}' {found}: expected {expected}")

    def check_keys(self, known: Collection[str], required: Mapping[str, str]) -> None:
        """Check which fields there are.

        Args:
            known: the keys that there may be.
            required: what is expected of each key that there has to be, in words.

        Raises:
            FnnEkfError: an unknown key, or one that is missing.
        """
        for key in self._content:
            if key not in known:
                raise self._error(
                    f"{self.label}: unknown key {_shown(key)}{suggestion(str(key), known)}"
                )
        for key, expected in required.items():
            if key not in self._content:
                raise self.refusal(key, expected)

    def value(self, key: str) -> Any:
        """Return a field as it is; None if it is missing."""
        return self._content.get(key)

    def section(self, key: str, expected: str) -> "Fields":
        """Return a field that is a mapping itself.

        Raises:
            FnnEkfError: it is no mapping.
        """
        label = f"{self.label}, '{key}'"
        return Fields(self._content.get(key), label, self._kind, expected, self._remedy)

    def version(self, key: str, expected: int) -> None:
        """Check the version of a format.

        Raises:
            FnnEkfError: it is missing or another one.
        """
        found = self.value(key)
        if isinstance(found, bool) or found != expected:
            newer = isinstance(found, int) and found > expected
            raise self.refusal(key, f"{expected}{', or a newer fnn_ekf_ros' if newer else ''}")

    def choice(self, key: str, known: Collection[str]) -> str:
        """Return a field that is one of some words.

        Raises:
            FnnEkfError: it is missing or none of them.
        """
        value = self.value(key)
        if isinstance(value, str) and value in known:
            return value
        found = f"is {_shown(value)}" if key in self else "is missing"
        raise self._error(f"{self.label}: '{key}' {found}{suggestion(str(value), known)}")

    def whole(self, key: str) -> int:
        """Return a field that is a whole number.

        Raises:
            FnnEkfError: it is missing or none.
        """
        value = self.value(key)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.refusal(key, "a whole number")
        return value

    def number(
        self,
        key: str,
        expected: str = "a finite number",
        accept: Callable[[float], bool] = lambda _: True,
    ) -> float:
        """Return a field that is a finite number.

        Args:
            key: the field.
            expected: which numbers it may be, in words.
            accept: whether it may be this one.

        Raises:
            FnnEkfError: it is missing, no finite number, or not accepted.
        """
        number = finite_number(self.value(key))
        if number is None or not accept(number):
            raise self.refusal(key, expected)
        return number

    def number_between(self, key: str, low: float, high: float, unit: str) -> float:
        """Return a field that is a number in a range.

        Raises:
            FnnEkfError: it is missing, no number, or out of the range.
        """
        expected = f"a number from {low:g} to {high:g} [{unit}]"
        return self.number(key, expected, lambda number: low <= number <= high)

    def numbers(self, key: str, count: int) -> list[float]:
        """Return a field that is a list of finite numbers.

        Raises:
            FnnEkfError: it is missing, or no list of so many.
        """
        numbers = _numbers(self.value(key), count)
        if numbers is None:
            raise self.refusal(key, f"a list of {count} finite numbers")
        return numbers

    def matrix(self, key: str, rows: int, columns: int) -> list[list[float]]:
        """Return a field that is a list of rows of finite numbers.

        Raises:
            FnnEkfError: it is missing, or no matrix of this size.
        """
        value = self.value(key)
        entries = value if isinstance(value, list) and len(value) == rows else [None]
        found = [_numbers(entry, columns) for entry in entries]
        checked = [row for row in found if row is not None]
        if len(checked) < rows:
            raise self.refusal(key, f"{rows} lists of {columns} finite numbers")
        return checked

    def _error(self, text: str) -> FnnEkfError:
        return self._kind(f"{text}; {self._remedy}" if self._remedy else text)


def suggestion(name: str, known: Collection[str]) -> str:
    """Return the end of a refusal: the known name that was meant, or all of them."""
    import difflib  # only a refusal needs it

    close = difflib.get_close_matches(name, known, n=1)
    return f": did you mean '{close[0]}'?" if close else f": expected one of {', '.join(known)}"


def as_number(value: Any) -> float | None:
    """Return a number as a float; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf


def finite_number(value: Any) -> float | None:
    """Return a finite number as a float; None for anything else."""
    number = as_number(value)
    return number if number is not None and math.isfinite(number) else None


def _numbers(value: Any, count: int) -> list[float] | None:
    if not isinstance(value, list) or len(value) != count:
        return None
    numbers = [number for entry in value if (number := finite_number(entry)) is not None]
    return numbers if len(numbers) == count else None


def _shown(value: Any) -> str:
    """Return a value in few characters; `nothing` for an empty file or field."""
    return "nothing" if value is None else reprlib.repr(value)
