"""What the page says in words: HTML of the moment that is shown, and the strip of states."""

from __future__ import annotations

import html
import itertools
import math

import numpy as np

from ik_node.interfaces.step import Mode
from ik_node.math.types import Array
from ik_node.report.summary_page import MODE_COLOURS
from ik_node.viewer.timeline import Film, Moment

STRIP_CELLS = 600
_DARK_TEXT = frozenset({Mode.WAITING, Mode.HOLDING, Mode.RAMPING, Mode.PAUSED})
_ROW = '<tr><td style="color:#667;padding:1px 8px 1px 0">{}</td><td style="text-align:right">{}</td></tr>'


def describe(
    moment: Moment,
    joints: tuple[str, ...],
    velocity_limits: Array,
    mass_weighted: bool,
) -> str:
    """HTML of what holds at a moment. Words that came from outside are escaped."""
    error, unit = moment.error_b, "N s" if mass_weighted else ""
    rows = [
        ("position error", _number(1e3 * _norm(error[:3]), "mm", 3)),
        ("orientation error", _number(1e3 * _norm(error[3:]), "mrad", 3)),
        ("fastest joint", _fastest(moment.joint_velocity, joints, velocity_limits)),
        ("least singular value", _number(moment.sigma_min, "m", 4)),
        ("scale s", _number(moment.scale, "", 3)),
        ("limits that bind", html.escape(", ".join(moment.binding)) or "none"),
        ("\u03bb task, linear", _number(_norm(moment.multiplier_task[:3]), unit, 3)),
        ("\u03bb potential, linear", _number(_norm(moment.multiplier_potential[:3]), unit, 3)),
        ("clearance", _number(1e3 * moment.clearance, "mm", 1)),
    ]
    if moment.closest_pair:
        rows.append(("nearest", html.escape(" \u2013 ".join(moment.closest_pair))))
    table = "".join(_ROW.format(name, value) for name, value in rows)
    return (
        f'<div style="padding:0 12px;font-size:13px"><div style="margin:2px 0 6px">{_badge(moment)}</div>'
        f'<table style="width:100%;border-collapse:collapse;font-variant-numeric:tabular-nums">{table}</table></div>'
    )


def _badge(moment: Moment) -> str:
    mode = moment.status.mode
    ink = "#222" if mode in _DARK_TEXT else "#fff"
    return (
        f'<span style="background:{MODE_COLOURS[mode]};color:{ink};border-radius:4px;padding:1px 8px;'
        f'font-weight:600">{mode.value}</span> <span>{html.escape(moment.status.reason)}</span>'
    )


def _fastest(joint_velocity: Array, joints: tuple[str, ...], velocity_limits: Array) -> str:
    parts = np.abs(joint_velocity) / velocity_limits
    if not np.isfinite(parts).all():
        return "not computed"
    fastest = int(np.argmax(parts))
    return f"{html.escape(joints[fastest])} {100.0 * parts[fastest]:.1f} %"


def _norm(values: Array) -> float:
    return float(np.linalg.norm(values))


def _number(value: float, unit: str, digits: int) -> str:
    return "not computed" if math.isnan(value) else f"{value:.{digits}f} {unit}".rstrip()


def strip(film: Film, left_px: int, right_px: int) -> str:
    """HTML of a bar of the film's states over time, as wide as the plots' axes, with a legend."""
    if not film.status or film.end_s <= film.begin_s:
        return ""
    cells = np.linspace(film.begin_s, film.end_s, STRIP_CELLS, endpoint=False)
    modes = [film.status[film.row(time_s)].mode for time_s in cells.tolist()]
    bars = "".join(
        f'<div style="flex:{len(list(group))};background:{MODE_COLOURS[mode]}"></div>'
        for mode, group in itertools.groupby(modes)
    )
    present = dict.fromkeys(status.mode for status in dict.fromkeys(film.status))
    legend = " ".join(
        f'<span style="white-space:nowrap"><span style="color:{MODE_COLOURS[mode]}">&#9632;</span> {mode.value}</span>'
        for mode in present
    )
    return (
        f'<div style="padding:2px 12px 0;font-size:11px;color:#445">{legend}</div>'
        f'<div style="display:flex;height:10px;margin:2px {right_px}px 4px {left_px}px;overflow:hidden;'
        f'border-radius:2px">{bars}</div>'
    )


def note(text: str) -> str:
    """HTML of a remark; the text is escaped."""
    return f'<div style="padding:0 12px;font-size:12px;color:#8a4b00;overflow-wrap:anywhere">{html.escape(text)}</div>'
