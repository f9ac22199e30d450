# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Making and writing pictures; the only place that asks whether matplotlib is installed."""

import warnings
from pathlib import Path
from typing import Any

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import readable, written_whole

DPI = 110
"""Default resolution of a picture [dots per inch]: legible on a screen, and small as a file."""


def require_matplotlib() -> None:
    """Check that pictures can be made.

    Raises:
        FnnEkfError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise FnnEkfError("pictures need matplotlib: install it, or fnn_ekf_ros[tools]") from None
    del Figure


def new_figure(width: float, height: float, fixed_aspect: bool = False) -> Any:
    """Return an empty figure of a size [inch], for panels of fixed aspect or of any.

    Raises:
        FnnEkfError: matplotlib is not installed.
    """
    require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="compressed" if fixed_aspect else "constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Any, path: Path, dpi: int = DPI) -> None:
    """Write a figure, completely or not at all; as a PNG if its name does not say otherwise.

    Raises:
        FnnEkfError: the file cannot be written.
    """
    kind = path.suffix.removeprefix(".").lower() or "png"
    metadata = {"Software": None} if kind == "png" else None
    with written_whole(path) as file, warnings.catch_warnings():
        # Names may be in any script; a box stands for what the font does not have.
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        figure.savefig(file, format=kind, dpi=dpi, metadata=metadata)


def shown_text(name: str) -> str:
    """Return a name as matplotlib shows it: no formulas, and nothing that is no text."""
    return readable(name).replace("$", r"\$")
