"""Texts of the page as HTML: values and mode of the displayed frame, the mode bar, and notes."""

from __future__ import annotations

import html
import itertools

import numpy as np

from ik_node.interfaces.twist_account import twist_account
from ik_node.math.types import Array
from ik_node.report import quantities
from ik_node.report.quantities import DisplayedQuantity
from ik_node.report.style import MODE_COLOURS, TEXT_COLOUR
from ik_node.report.timeline import DARK_TEXT
from ik_node.viewer.timeline import Timeline, TimelineFrame

BAR_CELLS = 600
NOT_COMPUTED = "not computed"
_ROW = '<tr><td style="color:#667;padding:1px 8px 1px 0">{}</td><td style="text-align:right">{}</td></tr>'


def frame_html(
    frame: TimelineFrame,
    joints: tuple[str, ...],
    velocity_limits: Array,
    mass_weighted: bool,
) -> str:
    """Values and mode of one frame as HTML.

    Args:
        frame: The displayed frame.
        joints: Joint names.
        velocity_limits: (n,), rad/s (m/s).
        mass_weighted: Whether the multiplier has units of momentum.

    Returns:
        HTML in which names and reasons are escaped.
    """
    unit = "N s" if mass_weighted else ""
    account = twist_account(frame.twist_b, frame.truncated_b, frame.off_direction_b, frame.scale)
    rows = [
        _row(quantities.POSITION_ERROR, _norm(frame.error_b[:3])),
        _row(quantities.ORIENTATION_ERROR, _norm(frame.error_b[3:])),
        ("fastest joint", _fastest_joint(frame.joint_velocity, joints, velocity_limits)),
        _row(quantities.SMALLEST_SINGULAR_VALUE, frame.sigma_min),
        _row(quantities.SCALE, frame.scale),
        _row(quantities.HELD_BACK_LINEAR, _norm(account.held_back[:3])),
        _row(quantities.TRUNCATED_LINEAR, _norm(account.truncated[:3])),
        _row(quantities.OFF_DIRECTION_LINEAR, _norm(account.off_direction[:3])),
        ("active limits", html.escape(", ".join(frame.binding)) or "none"),
        _row(quantities.MULTIPLIER_TASK_LINEAR._replace(unit=unit), _norm(frame.multiplier_task[:3])),
        _row(quantities.MULTIPLIER_POTENTIAL_LINEAR._replace(unit=unit), _norm(frame.multiplier_potential[:3])),
        _row(quantities.CLEARANCE, frame.clearance),
    ]
    if frame.off_direction_limits:
        rows.append(("limits that cause it", html.escape(", ".join(frame.off_direction_limits))))
    if frame.closest_pair:
        rows.append(("closest pair", html.escape(" \u2013 ".join(frame.closest_pair))))
    table = "".join(_ROW.format(name, value) for name, value in rows)
    return (
        f'<div style="padding:0 12px;font-size:13px"><div style="margin:2px 0 6px">{_badge(frame)}</div>'
        f'<table style="width:100%;border-collapse:collapse;font-variant-numeric:tabular-nums">{table}</table></div>'
    )


def _row(quantity: DisplayedQuantity, value: float) -> tuple[str, str]:
    return quantity.name, quantity.text(value, NOT_COMPUTED, with_unit=True)


def _badge(frame: TimelineFrame) -> str:
    mode = frame.status.mode
    text_colour = TEXT_COLOUR if mode in DARK_TEXT else "#fff"
    return (
        f'<span style="background:{MODE_COLOURS[mode]};color:{text_colour};border-radius:4px;padding:1px 8px;'
        f'font-weight:600">{mode.value}</span> <span>{html.escape(frame.status.reason)}</span>'
    )


def _fastest_joint(joint_velocity: Array, joints: tuple[str, ...], velocity_limits: Array) -> str:
    ratios = np.abs(joint_velocity) / velocity_limits
    if not np.isfinite(ratios).all():
        return NOT_COMPUTED
    fastest = int(np.argmax(ratios))
    return f"{html.escape(joints[fastest])} {100.0 * ratios[fastest]:.1f} %"


def _norm(values: Array) -> float:
    return float(np.linalg.norm(values))


def mode_bar_html(timeline: Timeline, left_px: int, right_px: int) -> str:
    """The modes over time as a coloured bar with a legend.

    Args:
        timeline: What to show.
        left_px: Left margin of the bar; that of the plots' axes.
        right_px: Right margin.
    """
    if not timeline.status or timeline.end_s <= timeline.begin_s:
        return ""
    cells = np.linspace(timeline.begin_s, timeline.end_s, BAR_CELLS, endpoint=False)
    modes = [timeline.status[timeline.row(time_s)].mode for time_s in cells.tolist()]
    bars = "".join(
        f'<div style="flex:{len(list(group))};background:{MODE_COLOURS[mode]}"></div>'
        for mode, group in itertools.groupby(modes)
    )
    present = dict.fromkeys(status.mode for status in dict.fromkeys(timeline.status))
    legend = " ".join(
        f'<span style="white-space:nowrap"><span style="color:{MODE_COLOURS[mode]}">&#9632;</span> {mode.value}</span>'
        for mode in present
    )
    return (
        f'<div style="padding:2px 12px 0;font-size:11px;color:#445">{legend}</div>'
        f'<div style="display:flex;height:10px;margin:2px {right_px}px 4px {left_px}px;overflow:hidden;'
        f'border-radius:2px">{bars}</div>'
    )


def note_html(text: str) -> str:
    """A note as HTML; the text is escaped."""
    return f'<div style="padding:0 12px;font-size:12px;color:#8a4b00;overflow-wrap:anywhere">{html.escape(text)}</div>'
