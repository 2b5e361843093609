"""All pages about one recording or several, as files: PDF, PNG (the pages below each other), SVG (the first page)."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ik_node.report.canvas import drawing, saving
from ik_node.report.joints_page import draw_joints
from ik_node.report.overlay import draw_overlay
from ik_node.report.reported_run import Subject
from ik_node.report.solver_page import draw_law
from ik_node.report.states_page import draw_states
from ik_node.report.style import DPI
from ik_node.report.summary_page import overview


class Page(NamedTuple):
    """A page, drawn."""

    heading: str
    about: str
    """What a person sees on it."""
    figure: Any


def pages(subjects: Sequence[Subject]) -> tuple[Page, ...]:
    """Draws; to be called while :func:`~ik_node.report.canvas.drawing` lasts."""
    alone = subjects[0] if len(subjects) == 1 else None
    first = draw_overlay(subjects) if alone is None else overview(alone.run, alone.report)
    return (
        Page("Overview", "Path of the tool in 3-D, errors, what slowed the arm, and what the controller did.", first),
        Page("Joints", "Positions and velocity commands of every joint between their limits.", draw_joints(subjects)),
        Page("Law", "Singular values, scale s, clearance, and both terms of the multiplier.", draw_law(subjects)),
        Page("Ticks and states", "Times between ticks, and the states with their reasons.", draw_states(subjects)),
    )


def write_pdf(subjects: Sequence[Subject], path: Path) -> None:
    """A vector page per picture; RecordingError when it cannot be written."""
    with drawing():
        from matplotlib.backends.backend_pdf import PdfPages

        drawn = pages(subjects)
        # No date: the same recordings give the same bytes.
        with saving(), PdfPages(path, metadata={"CreationDate": None, "Title": title_of(subjects)}) as file:
            for page in drawn:
                file.savefig(page.figure)


def write_png(subjects: Sequence[Subject], path: Path) -> None:
    """The pages below each other in one picture; RecordingError when it cannot be written."""
    with drawing():
        from matplotlib.image import imsave

        images = []
        for page in pages(subjects):
            page.figure.set_dpi(DPI)
            page.figure.canvas.draw()
            images.append(np.asarray(page.figure.canvas.buffer_rgba()).copy())
        with saving():
            imsave(path, np.concatenate(images), format="png")


def write_svg(subjects: Sequence[Subject], path: Path) -> None:
    """The first page only; RecordingError when it cannot be written."""
    with drawing(), saving():
        path.write_bytes(as_svg(pages(subjects)[0]))


def as_svg(page: Page) -> bytes:
    """One page as an SVG file."""
    file = io.BytesIO()
    page.figure.savefig(file, format="svg", metadata={"Date": None})
    return file.getvalue()


def title_of(subjects: Sequence[Subject]) -> str:
    """The recordings' names in one line."""
    return ", ".join(subject.name for subject in subjects)
