# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Figures as SVG inside of a page: small, and in the page's own colors, light or dark."""

import io
import re
import warnings
from typing import Any

from fnn_ekf_ros.reports.pictures import new_figure

COLORS = {
    "ink": "#010203", "quiet": "#020304", "line": "#030405", "estimate": "#040506",
    "truth": "#050607", "fix": "#060708", "bad": "#070809", "second": "#08090a", "ok": "#090a0b",
    "warn": "#0a0b0c", "third": "#0b0c0d",
}  # fmt: skip
"""Colors of a figure, by the page's name for them: stand-ins, replaced by the page's variables."""
WIDTH = 4.8
"""Width of a figure [inch]: a phone shows it at nearly its own size, so that text is readable."""
TEXT_SIZE = 10.5
"""Size of text [points]."""
_STYLE = {
    "svg.fonttype": "none", "svg.hashsalt": "fnn_ekf_ros", "font.size": TEXT_SIZE,
    "axes.edgecolor": COLORS["line"], "axes.labelcolor": COLORS["ink"],
    "text.color": COLORS["ink"], "xtick.color": COLORS["line"], "ytick.color": COLORS["line"],
    "xtick.labelcolor": COLORS["ink"], "ytick.labelcolor": COLORS["ink"],
    "grid.color": COLORS["line"], "grid.linewidth": 0.4, "axes.spines.top": False,
    "axes.spines.right": False, "axes.facecolor": "none", "figure.facecolor": "none",
    "legend.frameon": False, "legend.fontsize": TEXT_SIZE - 0.5, "axes.unicode_minus": False,
    "path.simplify_threshold": 0.25, "axes.formatter.useoffset": False,
}  # fmt: skip
"""Style of the figures."""


def styled() -> Any:
    """Return a context in which figures are made and turned into text."""
    from matplotlib import rc_context

    return rc_context(_STYLE)


def panels(count: int, height: float) -> tuple[Any, list[Any]]:
    """Return a figure of panels above each other that share the time axis.

    Args:
        count: number of panels.
        height: of each [inch].
    """
    figure = new_figure(WIDTH, 0.75 + height * count)
    axes = list(figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])
    for each in axes:
        each.grid(visible=True)
        each.set_axisbelow(True)
        each.margins(x=0.01)
    return figure, axes


def svg_text(figure: Any, title: str) -> str:
    """Return a figure as an element of a page, named by a title for those who cannot see it."""
    buffer = io.StringIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'<g id="[^"]*">', "<g>", text)
    opening = rf'<svg viewBox="\1" role="img" aria-label="{title}">'
    text = re.sub(r'<svg [^>]*viewBox="([^"]*)"[^>]*>', opening, text, count=1)
    text = text.replace("xlink:href", "href")
    text = re.sub(r'="[^"]*"', lambda found: re.sub(r"(\.\d\d)\d+", r"\1", found[0]), text)
    for name, color in COLORS.items():
        text = text.replace(color, f"var(--{name})")
    return re.sub(r"\n\s*", "\n", text).strip()
