"""Colours, lines and axes that the pictures of a run share.

Colours are those of Okabe and Ito (and cividis), which people with any colour vision tell apart.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ik_node.interfaces.step import Mode
from ik_node.math.types import Array

INK = "#222222"
FAINT = "#c8ccd0"
GREY = "#888888"
BLUE = "#0072b2"
VERMILION = "#d55e00"
GREEN = "#009e73"
SUBJECT_COLOURS = (BLUE, VERMILION, GREEN, "#cc79a7", "#e69f00", "#56b4e9")
"""One per recording; they begin anew after the last."""
MODE_COLOURS = {
    Mode.WAITING: "#bbbbbb",
    Mode.HOLDING: "#56b4e9",
    Mode.TRACKING: "#009e73",
    Mode.RAMPING: "#f0e442",
    Mode.PAUSED: "#e69f00",
    Mode.STOPPED: "#d55e00",
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
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.grid": True,
    "grid.color": "#e6e8ea",
    "lines.linewidth": 1.1,
    "svg.hashsalt": "ik_node",  # the same run gives the same bytes
}
MOST_POINTS = 4000
"""Per line; beyond that the extremes of neighbouring points are drawn."""
WIDTH_IN = 14.0
DPI = 110


def thin(times: Array, values: Array) -> tuple[Array, Array]:
    """At most about ``MOST_POINTS`` points that keep every peak: the least and the largest of each run of neighbours.

    A run that holds NaN only stays NaN.
    """
    if len(times) <= MOST_POINTS:
        return times, values
    width = -(-2 * len(times) // MOST_POINTS)
    whole = len(times) // width * width
    blocks = values[:whole].reshape(-1, width)
    finite = np.isfinite(blocks)
    low, high = np.where(finite, blocks, np.inf).argmin(axis=1), np.where(finite, blocks, -np.inf).argmax(axis=1)
    base = np.arange(0, whole, width)
    rows = np.sort(np.stack((base + low, base + high), axis=1), axis=1).ravel()
    rows = np.concatenate((rows, np.arange(whole, len(times))))
    return times[rows], values[rows]


def remark(axes: Any, text: str) -> None:
    """Words in the place of a line, where there is nothing to draw."""
    axes.annotate(text, (0.5, 0.45), xycoords="axes fraction", ha="center", va="center", color=GREY)
    axes.set_yticks([])
    axes.grid(visible=False)


def heading(figure: Any, text: str) -> None:
    """What a page is about, in its upper left corner."""
    y = 1.0 - 0.14 / figure.get_figheight()
    figure.suptitle(text, x=0.03, y=y, ha="left", va="top", fontsize=13, fontweight="bold")


def names_on(figure: Any, names: list[tuple[str, str]]) -> None:
    """A legend of (name, colour) in the upper right corner of the page."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colour, linewidth=3.0, label=name) for name, colour in names]
    corner = (0.985, 1.0 - 0.1 / figure.get_figheight())
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=corner, ncols=len(handles), frameon=False)


def only_last_has_times(column: list[Any], times: tuple[float, float], label: str = "time [s]") -> None:
    """Axes above each other that share their times: labels at the lowest."""
    for axes in column[:-1]:
        axes.tick_params(labelbottom=False)
    column[-1].set_xlabel(label)
    if times[1] > times[0]:
        for axes in column:
            axes.set_xlim(*times)
