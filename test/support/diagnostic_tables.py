# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The tables of messages in docs/diagnostics.md."""

import re

from places import DOCS

from fnn_ekf_ros.timeline.events import Level

DOCUMENT = DOCS / "diagnostics.md"


def message_tables() -> dict[str, dict[str, set[Level]]]:
    """Return the messages of each status, as the document has them, with their levels."""
    text = DOCUMENT.read_text(encoding="utf-8")
    tables: dict[str, dict[str, set[Level]]] = {}
    for heading, section in re.findall(
        r"^## (Status(?:es)? .*)\n((?:(?!## ).*\n)*)", text, flags=re.MULTILINE
    ):
        rows = re.findall(r"^\| `([^|]+)` \| ([A-Z, ]+) \|", section, flags=re.MULTILINE)
        for status in re.findall(r"`(\w+)`", heading):
            found = tables.setdefault(status, {})
            known = len(found)
            found |= {
                message: {Level[name] for name in levels.split(", ")} for message, levels in rows
            }
            assert len(found) == known + len(rows), f"{status}: a message is listed twice"
    return tables
