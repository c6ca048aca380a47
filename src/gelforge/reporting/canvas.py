"""Figures for all pictures of the project, without a display, and their PNG."""

import io
import warnings
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

DPI = 110


def canvas(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """An empty figure, width and height in inches; layout None leaves the placement to the caller."""
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def canvas_with_axes(rows: int, columns: int, width: float, height: float) -> tuple[Figure, np.ndarray]:
    """A figure, width and height in inches, and its axes (rows, columns)."""
    figure = canvas(width, height)
    return figure, figure.subplots(rows, columns, squeeze=False)


def save_png(path: Path | str, figure: Figure) -> None:
    """Write a figure as PNG to `path` directly; the caller makes it atomic (flow.files.publish)."""
    _save(path, figure)


def to_png(figure: Figure) -> bytes:
    """A figure as PNG bytes, with empty margins trimmed."""
    stream = io.BytesIO()
    _save(stream, figure, bbox_inches="tight")
    return stream.getvalue()


def _save(target: Path | str | io.BytesIO, figure: Figure, **form: Any) -> None:
    """Write a figure as PNG; glyphs that the font lacks, as in file names, become boxes without a warning."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ .*missing from", UserWarning)
        figure.savefig(target, format="png", dpi=DPI, **form)
