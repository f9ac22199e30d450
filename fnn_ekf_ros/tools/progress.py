"""Progress on a terminal, if tqdm is installed; silence elsewhere."""

import sys
from collections.abc import Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")


def with_progress(items: Iterable[T], total: int, label: str) -> Iterator[T]:
    """Yield the items while a bar on stderr shows how many of `total` have passed."""
    try:
        from tqdm import tqdm
    except ImportError:
        yield from items
        return
    hidden = not sys.stderr.isatty()
    yield from tqdm(items, total=total, desc=label, disable=hidden, leave=False, unit_scale=True)
