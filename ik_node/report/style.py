"""Colours, line styles and axis helpers shared by all plots.

The colours are those of Okabe and Ito, which can be distinguished with any colour vision.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ik_node.interfaces.step import Mode
from ik_node.math.types import Array

TEXT_COLOUR = "#222222"
LIGHT_GREY = "#c8ccd0"
GREY = "#888888"
BLUE = "#0072b2"
VERMILION = "#d55e00"
GREEN = "#009e73"
AMBER = "#e69f00"
"""Where the arm is slowed."""
RED = "#b5122b"
"""Where a direction is given up."""
PURPLE = "#cc79a7"
RUN_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, AMBER, "#56b4e9")
"""One per recording, reused cyclically."""
MODE_COLOURS = {
    Mode.WAITING: "#bbbbbb",
    Mode.HOLDING: "#56b4e9",
    Mode.TRACKING: "#009e73",
    Mode.RAMPING: "#f0e442",
    Mode.PAUSED: "#cc79a7",
    Mode.STOPPED: "#555555",
    Mode.FAULT: "#000000",
}
STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888888",
    "axes.labelcolor": TEXT_COLOUR,
    "text.color": TEXT_COLOUR,
    "xtick.color": TEXT_COLOUR,
    "ytick.color": TEXT_COLOUR,
    "axes.grid": True,
    "grid.color": "#e6e8ea",
    "lines.linewidth": 1.1,
    "svg.hashsalt": "ik_node",  # the same run gives the same file
}
MAX_POINTS = 4000
"""Per line; longer series are decimated to the extremes of neighbouring points."""
WIDTH_IN = 14.0
DPI = 110


def decimate(times: Array, values: Array) -> tuple[Array, Array]:
    """Decimates a series to about ``MAX_POINTS`` points, keeping minimum and maximum of each block of neighbours.

    A block of NaN remains NaN.
    """
    if len(times) <= MAX_POINTS:
        return times, values
    width = -(-2 * len(times) // MAX_POINTS)
    used = len(times) // width * width
    blocks = values[:used].reshape(-1, width)
    finite = np.isfinite(blocks)
    low, high = np.where(finite, blocks, np.inf).argmin(axis=1), np.where(finite, blocks, -np.inf).argmax(axis=1)
    base = np.arange(0, used, width)
    rows = np.sort(np.stack((base + low, base + high), axis=1), axis=1).ravel()
    rows = np.concatenate((rows, np.arange(used, len(times))))
    return times[rows], values[rows]


def placeholder(axes: Any, text: str) -> None:
    """Shows a text in axes that have no data."""
    axes.annotate(text, (0.5, 0.45), xycoords="axes fraction", ha="center", va="center", color=GREY)
    axes.set_yticks([])
    axes.grid(visible=False)


def placeholder_text(axes: Any) -> str:
    """The text of :func:`placeholder` in these axes; empty for axes with data."""
    return str(axes.texts[0].get_text()) if axes.texts and not axes.lines else ""


def legend_above(axes: Any, columns: int = 3) -> None:
    """Shows the legend on the right, above the plot, beside its title."""
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 0.97),
        ncols=columns,
        frameon=False,
        fontsize=8,
        handlelength=1.4,
        columnspacing=0.9,
    )


def page_heading(figure: Any, text: str) -> None:
    """Title in the upper left corner of a page."""
    y = 1.0 - 0.14 / figure.get_figheight()
    figure.suptitle(text, x=0.03, y=y, ha="left", va="top", fontsize=13, fontweight="bold")


def run_legend(figure: Any, names: list[tuple[str, str]]) -> None:
    """Legend of (name, colour) in the upper right corner of a page."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colour, linewidth=3.0, label=name) for name, colour in names]
    corner = (0.985, 1.0 - 0.1 / figure.get_figheight())
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=corner, ncols=len(handles), frameon=False)


def share_time_axis(column: list[Any], times: tuple[float, float], label: str = "time [s]") -> None:
    """Gives stacked axes the same time axis, labelled at the lowest."""
    for axes in column[:-1]:
        axes.tick_params(labelbottom=False)
    column[-1].set_xlabel(label)
    if times[1] > times[0]:
        for axes in column:
            axes.set_xlim(*times)
