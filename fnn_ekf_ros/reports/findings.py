# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Findings of `doctor --json`, as the report shows them."""

import json
from pathlib import Path
from typing import Any, NamedTuple

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import read_text

LEVELS = {
    "ok": "ok", "info": "ok", "possible": "ok", "warn": "warn", "warning": "warn", "likely": "warn",
    "error": "bad", "certain": "bad",
}  # fmt: skip
"""How a level of a finding, or how sure it is, is shown."""
_TITLE = ("sentence", "title", "message", "text")
_LEVEL = ("level", "severity", "certainty")
"""Keys of a finding that have its sentence, and how bad it is; the first that is there counts."""


class Finding(NamedTuple):
    """Something that was found.

    Attributes:
        level: `ok`, `warn` or `bad`.
        title: the sentence.
        details: further keys and values.
    """

    level: str
    title: str
    details: tuple[tuple[str, str], ...]


def read_findings(path: Path) -> list[Finding]:
    """Return the findings of a JSON file: a list, or an object with a list `findings`.

    Each is a sentence, or an object with a `sentence` (or `title`, `message`, `text`), perhaps a
    `certainty` (possible, likely, certain) or `level` (ok, warn, error), and anything else to show
    beside it.

    Raises:
        FnnEkfError: it is none.
    """
    expected = "a list of findings, or an object with 'findings', as doctor --json writes it"
    text = read_text(path, "findings", FnnEkfError, expected)
    try:
        content = json.loads(text)
    except ValueError as error:
        raise FnnEkfError(f"findings '{path}' are no JSON ({error}): expected {expected}") from None
    if isinstance(content, dict):
        content = content.get("findings")
    if not isinstance(content, list):
        raise FnnEkfError(f"findings '{path}': expected {expected}")
    return [_finding(path, number, entry) for number, entry in enumerate(content, start=1)]


def _finding(path: Path, number: int, entry: Any) -> Finding:
    if isinstance(entry, str):
        return Finding("warn", entry, ())
    title = _first(entry, _TITLE) if isinstance(entry, dict) else None
    if title is None:
        raise FnnEkfError(
            f"findings '{path}', number {number}: expected a sentence, or an object with one of "
            f"{', '.join(_TITLE)}"
        )
    level = LEVELS.get(str(_first(entry, _LEVEL) or "warn").lower(), "warn")
    details = [
        (str(key), _shown(value)) for key, value in entry.items()
        if key not in (*_LEVEL, _key(entry, _TITLE)) and value not in (None, "", [], {})
    ]  # fmt: skip
    return Finding(level, str(title), tuple(details))


def _key(entry: dict[str, Any], names: tuple[str, ...]) -> str | None:
    return next((name for name in names if entry.get(name)), None)


def _first(entry: dict[str, Any], names: tuple[str, ...]) -> Any:
    key = _key(entry, names)
    return None if key is None else entry[key]


def _shown(value: Any) -> str:
    """Return a value in one line; of a parameter to change its name and value."""
    if isinstance(value, list):
        return "; ".join(map(_shown, value))
    if isinstance(value, dict) and {"parameter", "value"} <= value.keys():
        unit = f" {value['unit']}" if value.get("unit") else ""
        text = f"{value['parameter']}: {_shown(value['value'])}{unit}"
        ends = [value.get(end) for end in ("low", "high")]
        return text if None in ends else f"{text} ({_shown(ends[0])} to {_shown(ends[1])})"
    if isinstance(value, float):
        return f"{value:.5g}"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
