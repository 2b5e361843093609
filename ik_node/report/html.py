"""A report as one self-contained HTML file: plots as embedded SVG, and tables.

The file contains no script and refers to nothing outside itself, so it works without a network. The markup is
well-formed XML.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from pathlib import Path

from ik_node.recording.run import Run
from ik_node.report.canvas import convert_write_errors, report_style
from ik_node.report.document import as_svg, document_title, draw_pages
from ik_node.report.quantities import NOT_AVAILABLE
from ik_node.report.reported_run import ReportedRun, time_label
from ik_node.report.style import AMBER, MODE_COLOURS, RED, TEXT_COLOUR
from ik_node.report.table import metric_rows
from ik_node.report.text import what_was_done
from ik_node.report.timeline import (
    DARK_TEXT,
    GIVEN_UP,
    SLOWED,
    StateInterval,
    condition_spans,
    state_intervals,
)
from ik_node.report.verdict import CAUSE_COLOURS, verdict
from ik_node.settings.groups import describe
from ik_node.settings.schema import Value

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; margin: 0 auto; max-width: 1320px; padding: 0 24px 48px; }
h1 { font-size: 1.7em; margin: 24px 0 4px; } h2 { margin: 36px 0 8px; border-bottom: 1px solid #ddd; }
nav { line-height: 2; } nav a { margin-right: 16px; display: inline-block; }
a { color: #0072b2; } p { margin: 6px 0; } .faint { color: #667; }
figure { margin: 12px 0 28px; overflow-x: auto; } figcaption { color: #667; }
figure img { box-sizing: border-box; width: 100%; min-width: 880px; border: 1px solid #e6e8ea; }
.verdict { font-size: 1.45em; font-weight: 700; line-height: 1.3; margin: 24px 0 4px; padding-left: 12px;
  border-left: 8px solid; overflow-wrap: anywhere; }
.done { color: #556; margin: 0 0 12px; } td.what { color: #667; min-width: 180px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 2px 18px 2px 0; vertical-align: top; border-bottom: 1px solid #eee; }
td.number, th.number { text-align: right; white-space: nowrap; } tr.differs td { background: #fff6e0; }
td.long { overflow-wrap: anywhere; max-width: 560px; }
.states td:last-child { min-width: 240px; }
.box { overflow: auto; max-height: 560px; border: 1px solid #e6e8ea; padding: 0 8px; }
.conditions { position: relative; height: 10px; margin: -4px 0 8px; background: #eef0f2; }
.conditions div { position: absolute; top: 0; height: 100%; }
.wide { overflow-x: auto; } .mode { border-radius: 4px; padding: 0 7px; font-weight: 600; }
.dot { display: inline-block; width: 11px; height: 11px; border-radius: 50%; margin-right: 6px; }
.mode-bar { display: flex; height: 16px; margin: 8px 0; border-radius: 3px; overflow: hidden; }
@media (max-width: 640px) { body { padding: 0 12px 32px; } th, td { padding-right: 10px; } h1 { font-size: 1.2em; }
  .verdict { font-size: 1.2em; }
  #metrics tr { display: grid; grid-template-columns: minmax(130px, 1fr) repeat(var(--runs), minmax(90px, 1fr)); }
  #metrics th, #metrics td { border-bottom: 0; white-space: normal; overflow-wrap: anywhere; }
  #metrics tr { border-bottom: 1px solid #eee; padding: 4px 0; } #metrics th:last-child { display: none; }
  #metrics td.what { grid-column: 1 / -1; } }
@media print { .box { max-height: none; overflow: visible; } figure { break-inside: avoid; } }
"""
MAX_CHARACTERS = 300
"""Of the displayed value of a parameter."""


def write_html(reported_runs: Sequence[ReportedRun], path: Path) -> None:
    """Writes the report; raises RecordingError when the file cannot be written."""
    text = as_html(reported_runs)
    with convert_write_errors():
        path.write_text(text, encoding="utf-8")


def as_html(reported_runs: Sequence[ReportedRun]) -> str:
    """The content of the file. Texts from recordings are escaped."""
    title = html.escape(document_title(reported_runs))
    sections = (
        ("plots", "Pictures", _plots(reported_runs)),
        ("metrics", "Numbers", _metrics(reported_runs)),
        ("timeline", "Timeline", "".join(_timeline(reported, len(reported_runs) > 1) for reported in reported_runs)),
        ("parameters", "Parameters that differ from the defaults", _parameters(reported_runs)),
        ("versions", "Versions", _versions(reported_runs)),
    )
    links = "".join(f'<a href="#{name}">{heading.split(" that ")[0]}</a>' for name, heading, _ in sections)
    body = "".join(f'<section id="{name}"><h2>{heading}</h2>{content}</section>' for name, heading, content in sections)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"/>'
        '<meta name="viewport" content="width=device-width, initial-scale=1"/>'
        f"<title>Report: {title}</title><style>{STYLE}</style></head>\n"
        f"<body>{_heading(reported_runs)}{_introduction(reported_runs)}<nav>{links}</nav>\n{body}</body></html>\n"
    )


def _heading(reported_runs: Sequence[ReportedRun]) -> str:
    """The verdict of every recording and what was done; the names of several."""
    texts = []
    for reported in reported_runs:
        found = verdict(reported.metrics, reported.zero_s)
        if len(reported_runs) > 1:
            texts.append(f"<h1>{_name(reported)}</h1>")
        colour = CAUSE_COLOURS.get(found.cause, AMBER)
        texts.append(f'<p class="verdict" style="border-color:{colour}">{html.escape(found.text)}</p>')
        done = what_was_done(reported.metrics)
        named = "" if len(reported_runs) > 1 or done.startswith(reported.name) else f"{reported.name}: "
        texts.append(f'<p class="done">{html.escape(named + done)}</p>')
    return "".join(texts)


def _introduction(reported_runs: Sequence[ReportedRun]) -> str:
    time_axis = time_label(reported_runs).removesuffix(" [s]")
    texts = [f"Times in plots and timelines: {time_axis}."] if time_axis != "time" else []
    for reported in reported_runs:
        if not reported.run.complete:
            texts.append(f"{reported.name} is truncated; its readable part is shown.")
        if reported.run.dropped:
            texts.append(f"{reported.name}: the recorder dropped {reported.run.dropped} messages.")
    return "".join(f'<p class="faint">{html.escape(text)}</p>' for text in texts)


def _metrics(reported_runs: Sequence[ReportedRun]) -> str:
    names = "".join(f'<th class="number">{_name(reported)}</th>' for reported in reported_runs)
    lines = "".join(
        f"<tr><td>{html.escape(row.label)}</td>"
        + "".join(f'<td class="number">{html.escape(value)}</td>' for value in row.values)
        + f'<td class="what">{html.escape(row.explanation)}</td></tr>'
        for row in metric_rows(reported_runs)
    )
    # On a narrow page the meaning is below label and numbers.
    return f'<div style="--runs: {len(reported_runs)}">{_table(f"{names}<th>meaning</th>", lines)}</div>'


def _plots(reported_runs: Sequence[ReportedRun]) -> str:
    with report_style():
        return "".join(
            f'<figure><img alt="{html.escape(page.heading)}" src="data:image/svg+xml;base64,'
            f'{base64.b64encode(as_svg(page)).decode()}"/>'
            f"<figcaption>{html.escape(page.heading)}: {html.escape(page.description)}</figcaption></figure>\n"
            for page in draw_pages(reported_runs)
        )


def _timeline(reported: ReportedRun, named: bool) -> str:
    intervals = state_intervals(reported)
    mode_bar = "".join(
        f'<div title="{html.escape(_interval_text(interval))}" '
        f'style="flex:{max(interval.duration_s, 0.0):.6f};background:{MODE_COLOURS[interval.mode]}"></div>'
        for interval in intervals
    )
    lines = "".join(
        f'<tr><td class="number">{interval.number}</td><td class="number">{interval.begin_s:.3f}</td>'
        f'<td class="number">{interval.duration_s:.3f}</td><td>{_badge(interval)}</td>'
        f"<td>{interval.level.name}</td><td>{html.escape(interval.reason)}</td></tr>"
        for interval in intervals
    )
    head = (
        '<tr><th class="number">no.</th><th class="number">from [s]</th><th class="number">for [s]</th>'
        "<th>mode</th><th>level</th><th>reason</th></tr>"
    )
    heading = f"<h3>{_name(reported)}</h3>" if named else ""
    return (
        f'{heading}<div class="mode-bar">{mode_bar}</div>{_condition_bar(reported)}'
        f'<div class="box"><table class="states"><thead>{head}</thead><tbody>{lines}</tbody></table></div>'
    )


def _condition_bar(reported: ReportedRun) -> str:
    """A bar with the times in which the arm was slowed (amber), or a direction was given up (red); empty for none."""
    begin, end = reported.span_s
    marks = condition_spans(reported)
    parts, legend = [], []
    for spans, colour, name in ((marks.slowed, AMBER, SLOWED), (marks.given_up, RED, GIVEN_UP)):
        for start, duration in spans:
            left, width = 100.0 * (start - begin) / (end - begin), 100.0 * duration / (end - begin)
            parts.append(f'<div style="left:{left:.3f}%;width:{width:.3f}%;background:{colour}"></div>')
        if spans:
            legend.append(f'<span class="mode" style="background:{colour};color:#fff">{name}</span>')
    return f'<div class="conditions">{"".join(parts)}</div><p>{" ".join(legend)}</p>' if parts else ""


def _interval_text(interval: StateInterval) -> str:
    return f"{interval.number}: {interval.begin_s:.2f} s, {interval.mode.value}: {interval.reason}"


def _badge(interval: StateInterval) -> str:
    colours = f"background:{MODE_COLOURS[interval.mode]};color:{TEXT_COLOUR if interval.mode in DARK_TEXT else '#fff'}"
    return f'<span class="mode" style="{colours}">{interval.mode.value}</span>'


def _parameters(reported_runs: Sequence[ReportedRun]) -> str:
    """Parameters at the start, and later changes; rows that differ between the recordings are marked."""
    lines = []
    for parameter in describe():
        values = [reported.run.settings.get(parameter.name) for reported in reported_runs]
        if all(value is None or value == parameter.default for value in values):
            continue
        differs = ' class="differs"' if any(value != values[0] for value in values) else ""
        unit = f" [{parameter.unit}]" if parameter.unit else ""
        cells = "".join(f'<td class="long">{_value(value)}</td>' for value in (parameter.default, *values))
        description = html.escape(parameter.description)
        lines.append(f'<tr{differs}><td title="{description}">{html.escape(parameter.name + unit)}</td>{cells}</tr>')
    names = "".join(f"<th>{_name(reported)}</th>" for reported in reported_runs)
    table = (
        f"<table><thead><tr><th>parameter</th><th>default</th>{names}</tr></thead><tbody>{''.join(lines)}</tbody></table>"
        if lines
        else "<p>None.</p>"
    )
    return f'<div class="wide">{table}</div>' + "".join(_changes(reported, reported.run) for reported in reported_runs)


def _changes(reported: ReportedRun, run: Run) -> str:
    if not run.setting_changes:
        return ""
    lines = "".join(
        f'<tr><td class="number">{time_s - reported.zero_s:.3f}</td><td>{html.escape(name)}</td>'
        f'<td class="long">{_value(value)}</td></tr>'
        for time_s, changed in run.setting_changes
        for name, value in changed.items()
    )
    head = '<tr><th class="number">at [s]</th><th>parameter</th><th>new value</th></tr>'
    return f"<h3>Changed during {_name(reported)}</h3><table><thead>{head}</thead><tbody>{lines}</tbody></table>"


def _value(value: Value | None) -> str:
    if value is None:
        return "not recorded"
    listed = isinstance(value, tuple)
    text = ", ".join(map(_number, value)) if isinstance(value, tuple) else _number(value)
    shown = text if len(text) <= MAX_CHARACTERS else f"{text[:MAX_CHARACTERS]}... ({len(text)} characters)"
    return html.escape(shown) or ("none" if listed else "empty")


def _number(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _versions(reported_runs: Sequence[ReportedRun]) -> str:
    lines = []
    for key in dict.fromkeys(key for reported in reported_runs for key in reported.run.versions):
        values = [reported.run.versions.get(key, NOT_AVAILABLE) for reported in reported_runs]
        differs = ' class="differs"' if len(set(values)) > 1 else ""
        cells = "".join(f"<td>{html.escape(value)}</td>" for value in values)
        lines.append(f"<tr{differs}><td>{html.escape(key)}</td>{cells}</tr>")
    names = "".join(f"<th>{_name(reported)}</th>" for reported in reported_runs)
    return _table(names, "".join(lines))


def _table(names: str, lines: str) -> str:
    """A table with one column per recording."""
    return f'<div class="wide"><table><thead><tr><th></th>{names}</tr></thead><tbody>{lines}</tbody></table></div>'


def _name(reported: ReportedRun) -> str:
    return f'<span class="dot" style="background:{reported.colour}"></span>{html.escape(reported.name)}'
