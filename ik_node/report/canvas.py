"""Where pictures are drawn: matplotlib without a screen, in one style."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ik_node.errors import RecordingError
from ik_node.report.style import STYLE, WIDTH_IN


@contextmanager
def drawing() -> Iterator[None]:
    """Our style while it lasts; RecordingError when matplotlib is not installed."""
    try:
        import matplotlib as mpl  # only here: everything else works without it
    except ImportError as error:
        raise RecordingError("pictures need matplotlib, which is not installed") from error
    with mpl.rc_context(STYLE):
        yield


@contextmanager
def saving() -> Iterator[None]:
    """RecordingError when what is done in it cannot write its file, or matplotlib does not know the ending."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise RecordingError(f"the picture cannot be written: {error}") from error


def new_figure(height_in: float) -> Any:
    """An empty page; of no window, and known to nobody but the caller."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in))
    FigureCanvasAgg(figure)
    return figure
