"""Matplotlib figures without a display, in one style."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ik_node.errors import MissingPackageError, RecordingError
from ik_node.report.style import STYLE, WIDTH_IN


@contextmanager
def report_style() -> Iterator[None]:
    """Context with the report's matplotlib style; raises MissingPackageError when matplotlib is not installed."""
    try:
        import matplotlib as mpl  # imported here because all other functions work without it
    except ImportError as error:
        raise MissingPackageError(error) from error
    with mpl.rc_context(STYLE):
        yield


@contextmanager
def convert_write_errors() -> Iterator[None]:
    """Context that converts errors of writing a file, and matplotlib's of an unknown suffix, to RecordingError."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise RecordingError(f"the report cannot be written: {error}") from error


def new_figure(height_in: float) -> Any:
    """An empty figure of the report's width, without a window and unknown to pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in))
    FigureCanvasAgg(figure)
    return figure
