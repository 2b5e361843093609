"""All pages of a report as a file: PDF, PNG (pages stacked vertically) or SVG (the first page)."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ik_node.report.canvas import convert_write_errors, report_style
from ik_node.report.joints_page import draw_joints
from ik_node.report.overlay import draw_overlay
from ik_node.report.reported_run import ReportedRun
from ik_node.report.solver_page import draw_solver
from ik_node.report.states_page import draw_states
from ik_node.report.style import DPI
from ik_node.report.summary_page import draw_summary


class ReportPage(NamedTuple):
    """One drawn page."""

    heading: str
    description: str
    figure: Any
    """matplotlib.figure.Figure."""


def draw_pages(reported_runs: Sequence[ReportedRun]) -> tuple[ReportPage, ...]:
    """Draws all pages; call it within :func:`~ik_node.report.canvas.report_style`."""
    first = draw_overlay(reported_runs) if len(reported_runs) > 1 else draw_summary(reported_runs[0])
    return (
        ReportPage("Summary", "Tool path, tracking errors, active limits and controller states.", first),
        ReportPage(
            "Joints", "Position and velocity command of every joint with its limits.", draw_joints(reported_runs)
        ),
        ReportPage(
            "Solver",
            "Singular values, task scale s, clearance, both multiplier terms, energies and null-space motion.",
            draw_solver(reported_runs),
        ),
        ReportPage(
            "Timing and states",
            "Control periods; hold-ups; age of the target; computing time; states with reasons.",
            draw_states(reported_runs),
        ),
    )


def write_pdf(reported_runs: Sequence[ReportedRun], path: Path) -> None:
    """Writes one vector page per drawn page; raises RecordingError when the file cannot be written."""
    with report_style():
        from matplotlib.backends.backend_pdf import PdfPages

        drawn = draw_pages(reported_runs)
        # No creation date: the same recordings give the same bytes.
        metadata = {"CreationDate": None, "Title": document_title(reported_runs)}
        with convert_write_errors(), PdfPages(path, metadata=metadata) as file:
            for page in drawn:
                file.savefig(page.figure)


def write_png(reported_runs: Sequence[ReportedRun], path: Path) -> None:
    """Writes the pages stacked vertically as one image; raises RecordingError when the file cannot be written."""
    with report_style():
        from matplotlib.image import imsave

        images = []
        for page in draw_pages(reported_runs):
            page.figure.set_dpi(DPI)
            page.figure.canvas.draw()
            images.append(np.asarray(page.figure.canvas.buffer_rgba()).copy())
        with convert_write_errors():
            imsave(path, np.concatenate(images), format="png")


def write_svg(reported_runs: Sequence[ReportedRun], path: Path) -> None:
    """Writes the first page; raises RecordingError when the file cannot be written."""
    with report_style(), convert_write_errors():
        path.write_bytes(as_svg(draw_pages(reported_runs)[0]))


def as_svg(page: ReportPage) -> bytes:
    """One page as the content of an SVG file."""
    file = io.BytesIO()
    page.figure.savefig(file, format="svg", metadata={"Date": None})
    return file.getvalue()


def document_title(reported_runs: Sequence[ReportedRun]) -> str:
    """The names of the recordings, separated by commas."""
    return ", ".join(reported.name for reported in reported_runs)
