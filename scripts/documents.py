# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Contents of README.md and docs/*.md: indented blocks, commands to run, files that are shown."""

import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
"""Folder of the clone."""
DOCUMENTS = ("README.md", *(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md"))))
"""Names of the documents that have examples."""
COMMAND = "python3 -m fnn_ekf_ros "
"""First words of a line of an example that is run; NAME stands for any command."""
SCENARIOS = "scenarios"
"""Section of docs/faults.md that `make scenarios` writes and `make faults` keeps."""
INDENTED = r"(?: {4}[^\n]*\n)+"
"""Pattern of an indented block."""


class Block(NamedTuple):
    """The commands of an indented block of a document."""

    document: str
    lines: tuple[str, ...]


def read(document: str) -> str:
    """Return a document's text."""
    return (ROOT / document).read_text(encoding="utf-8")


def blocks(text: str) -> list[str]:
    """Return the indented blocks of a document, each without its indentation."""
    found = re.findall(r"(?:^(?: {4}.*)?\n)+", text, flags=re.MULTILINE)
    return [re.sub(r"^ {4}", "", block, flags=re.MULTILINE) for block in found if block.strip()]


def examples(document: str) -> list[Block]:
    """Return the blocks of a document that have commands to run."""
    found = []
    for block in blocks(read(document)):
        lines = block.replace("\\\n", " ").splitlines()
        own = [line.strip() for line in lines if line.strip().startswith(COMMAND)]
        if own and COMMAND + "NAME" not in block:
            found.append(Block(document, tuple(own)))
    return found


def example(document: str, word: str) -> Block:
    """Return the block of a document that has a word in its commands."""
    (found,) = [b for b in examples(document) if word in " ".join(b.lines)]
    return found


def files(document: str) -> dict[str, str]:
    """Return the content of the files that a document shows after their names."""
    pattern = rf"`(\w+\.yaml)`(?:(?!\n\n).)*:\n\n({INDENTED})"
    found = re.findall(pattern, read(document), flags=re.DOTALL)
    return {name: re.sub(r"^ {4}", "", text, flags=re.MULTILINE) for name, text in found}


def section(text: str, name: str) -> str:
    """Return what stands between a section's marks in a document; empty if it has none."""
    begin, end = _marks(name)
    return text.partition(begin)[2].partition(end)[0].strip("\n")


def with_section(text: str, name: str, content: str) -> str:
    """Return a document's text with a section between its marks, at its place or at the end."""
    begin, end = _marks(name)
    before, _, rest = text.partition(begin)
    after = rest.partition(end)[2]
    between = content.strip("\n")
    return f"{before.rstrip()}\n\n{begin}\n\n{between}\n\n{end}\n{after.lstrip()}"


def _marks(name: str) -> tuple[str, str]:
    return f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
