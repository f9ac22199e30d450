# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Writes the copyright and the license at the top of each source file that lacks them.

The owner is the maintainer of package.xml, the license the one there, as an SPDX identifier.
"""

import argparse
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
"""Folder of the clone."""
YEAR = 2026
"""Year of the first publication."""
FOLDERS = ("fnn_ekf_ros", "launch", "scripts", "test")
"""Folders with source files."""
SUFFIXES = (".py", ".sh")
"""Endings of the names of source files."""


def header(root: Path) -> str:
    """Return the two lines, of a clone's package.xml."""
    manifest = ElementTree.parse(root / "package.xml").getroot()  # noqa: S314
    owner, license_name = (manifest.findtext(tag) for tag in ("maintainer", "license"))
    return f"# Copyright {YEAR} {owner}\n# SPDX-License-Identifier: {license_name}\n"


def sources(root: Path) -> Iterator[Path]:
    """Yield the source files of a clone."""
    yield root / "setup.py"
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob("*")):
            if path.suffix in SUFFIXES and path.is_file():
                yield path


def with_header(text: str, lines: str) -> str:
    """Return a source file's text with the header, below a line that begins with `#!`.

    Args:
        text: of the file.
        lines: the header.
    """
    first = re.match(r"#!.*\n", text)
    start = first[0] if first else ""
    rest = text[len(start) :]
    if rest.startswith(lines):
        return text
    return f"{start}{lines}\n{rest}" if rest else f"{start}{lines}"


def main(argv: Sequence[str] | None = None) -> int:
    """Write the headers; with `--check`, only name the files that lack them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if needed")
    arguments = parser.parse_args(argv)
    lines = header(ROOT)
    lacking = [
        path for path in sources(ROOT) if with_header(path.read_text(), lines) != path.read_text()
    ]
    for path in lacking:
        print(path.relative_to(ROOT))
        if not arguments.check:
            path.write_text(with_header(path.read_text(), lines))
    return int(arguments.check and bool(lacking))


if __name__ == "__main__":
    sys.exit(main())
