"""Texts of the page as HTML: values and mode of the displayed frame, the mode bar, and notes."""

from __future__ import annotations

import html
import itertools

import numpy as np

from ik_node.interfaces.twist_account import twist_account
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.report import quantities
from ik_node.report.deviation import TRUNCATION
from ik_node.report.metrics import RunMetrics
from ik_node.report.quantities import DisplayedQuantity
from ik_node.report.style import AMBER, MODE_COLOURS, RED, TEXT_COLOUR
from ik_node.report.text import what_was_done
from ik_node.report.timeline import DARK_TEXT, GIVEN_UP, SLOWED
from ik_node.report.verdict import CAUSE_COLOURS, verdict
from ik_node.viewer.task_plots import loose_texts
from ik_node.viewer.timeline import Timeline, TimelineFrame

BAR_CELLS = 600
NOT_COMPUTED = "not computed"
WHOLE_POSE = TaskTolerance()
_ROW = '<tr><td style="color:#667;padding:1px 8px 1px 0">{}</td><td style="text-align:right">{}</td></tr>'


def frame_html(
    frame: TimelineFrame,
    joints: tuple[str, ...],
    velocity_limits: Array,
    mass_weighted: bool,
    gradient_gain: float,
    tolerance: TaskTolerance = WHOLE_POSE,
) -> str:
    """Values and mode of one frame as HTML.

    Args:
        frame: The displayed frame.
        joints: Joint names.
        velocity_limits: (n,), rad/s (m/s).
        mass_weighted: Whether the multiplier has units of momentum.
        gradient_gain: The gain k; the potential term of the multiplier is shown divided by it.
        tolerance: The task; its components that are not exact are listed.

    Returns:
        HTML in which names and reasons are escaped.
    """
    unit = quantities.MULTIPLIER_TASK_LINEAR.unit if mass_weighted else ""
    gain = gradient_gain if gradient_gain > 0.0 else np.nan
    account = twist_account(frame.twist_b, frame.truncated_b, frame.off_direction_b, frame.scale)
    rows = [
        _row(quantities.TOOL_POSITION_ERROR, _norm(frame.error_b[:3])),
        _row(quantities.TOOL_ORIENTATION_ERROR, _norm(frame.error_b[3:])),
        *loose_texts(tolerance, frame.pose_sb, frame.pose_sd),
        ("fastest joint", _fastest_joint(frame.joint_velocity, joints, velocity_limits)),
        _row(quantities.SMALLEST_SINGULAR_VALUE, frame.sigma_min),
        _row(quantities.SCALE, frame.scale),
        _row(quantities.HELD_BACK_LINEAR, _norm(account.held_back[:3])),
        _row(quantities.TRUNCATED_LINEAR, _norm(account.truncated[:3])),
        _row(quantities.OFF_DIRECTION_LINEAR, _norm(account.off_direction[:3])),
        ("active limits", html.escape(", ".join(frame.binding)) or "none"),
        _row(quantities.MULTIPLIER_TASK_LINEAR._replace(unit=unit), _norm(frame.multiplier_task[:3])),
        _row(quantities.MULTIPLIER_POTENTIAL_LINEAR, _norm(frame.multiplier_potential[:3]) / gain),
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
    rows = [timeline.row(time_s) for time_s in cells.tolist()]
    given_up = np.abs(timeline.truncated_b).max(axis=1, initial=0.0) > TRUNCATION
    slowed = timeline.scale < 1.0
    shown = {}
    for begin, end in itertools.pairwise([*rows, len(timeline.times_s)]):
        within = slice(begin, max(end, begin + 1))  # a cell shows the worst of its control steps
        shown[begin] = _condition(timeline, begin, bool(slowed[within].any()), bool(given_up[within].any()))
    states = [shown[row] for row in rows]
    bars = "".join(
        f'<div style="flex:{len(list(group))};background:{colour}"></div>'
        for (_, colour), group in itertools.groupby(states)
    )
    legend = " ".join(
        f'<span style="white-space:nowrap"><span style="color:{colour}">&#9632;</span> {name}</span>'
        for name, colour in dict.fromkeys(states)
    )
    return (
        f'<div style="padding:2px 12px 0;font-size:11px;color:#445">{legend}</div>'
        f'<div style="display:flex;height:10px;margin:2px {right_px}px 4px {left_px}px;overflow:hidden;'
        f'border-radius:2px">{bars}</div>'
    )


def _condition(timeline: Timeline, row: int, slowed: bool, given_up: bool) -> tuple[str, str]:
    """Name and colour of a part of the bar: what happened to the motion, or else the mode."""
    mode = timeline.status[row].mode
    if given_up:
        return GIVEN_UP, RED
    return (SLOWED, AMBER) if slowed else (mode.value, MODE_COLOURS[mode])


def verdict_html(metrics: RunMetrics) -> str:
    """The verdict of a run beside a bar in the colour of its cause, and what was done, as HTML."""
    found = verdict(metrics)
    colour = CAUSE_COLOURS.get(found.cause, AMBER)
    return (
        f'<div style="margin:4px 12px;padding-left:8px;border-left:6px solid {colour};overflow-wrap:anywhere">'
        f'<div style="font-size:14px;font-weight:700;line-height:1.3">{html.escape(found.text)}</div>'
        f'<div style="font-size:12px;color:#556">{html.escape(what_was_done(metrics))}</div></div>'
    )


def note_html(text: str) -> str:
    """A note as HTML; the text is escaped."""
    return f'<div style="padding:0 12px;font-size:12px;color:#8a4b00;overflow-wrap:anywhere">{html.escape(text)}</div>'
