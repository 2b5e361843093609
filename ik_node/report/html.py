"""A report as one HTML file that needs nothing else: pictures as embedded SVG, and what is better read than looked at.

No script, no font, no address: it opens by a double click, without a network, and for as long as there are browsers.
The markup is well-formed XML too.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from pathlib import Path

from ik_node.recording.run import Run
from ik_node.report.canvas import drawing, saving
from ik_node.report.document import as_svg, pages, title_of
from ik_node.report.reported_run import Subject, time_label
from ik_node.report.style import INK, MODE_COLOURS
from ik_node.report.table import NONE, rows
from ik_node.report.timeline import DARK_TEXT, Entry, entries
from ik_node.settings.groups import Value, describe

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; margin: 0 auto; max-width: 1320px; padding: 0 24px 48px; }
h1 { font-size: 1.7em; margin: 24px 0 4px; } h2 { margin: 36px 0 8px; border-bottom: 1px solid #ddd; }
nav a { margin-right: 16px; } a { color: #0072b2; } p { margin: 6px 0; } .faint { color: #667; }
figure { margin: 12px 0 28px; } figure img { width: 100%; border: 1px solid #e6e8ea; } figcaption { color: #667; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 2px 18px 2px 0; vertical-align: top; border-bottom: 1px solid #eee; }
td.number, th.number { text-align: right; white-space: nowrap; } tr.differs td { background: #fff6e0; }
td.long { overflow-wrap: anywhere; max-width: 560px; }
.box { overflow: auto; max-height: 560px; border: 1px solid #e6e8ea; padding: 0 8px; }
.wide { overflow-x: auto; } .mode { border-radius: 4px; padding: 0 7px; font-weight: 600; }
.dot { display: inline-block; width: 11px; height: 11px; border-radius: 50%; margin-right: 6px; }
.strip { display: flex; height: 16px; margin: 8px 0; border-radius: 3px; overflow: hidden; }
@media print { .box { max-height: none; overflow: visible; } figure { break-inside: avoid; } }
"""
MOST_CHARACTERS = 300
"""Of a parameter's value."""


def write_html(subjects: Sequence[Subject], path: Path) -> None:
    """Writes the file; RecordingError when it cannot be written."""
    text = as_html(subjects)
    with saving():
        path.write_text(text, encoding="utf-8")


def as_html(subjects: Sequence[Subject]) -> str:
    """The whole file. Whatever comes from a recording is escaped."""
    title = html.escape(title_of(subjects))
    sections = (
        ("figures", "Figures", _figures(subjects)),
        ("pictures", "Pictures", _pictures(subjects)),
        ("timeline", "Timeline", "".join(_timeline(subject, len(subjects) > 1) for subject in subjects)),
        ("parameters", "Parameters that differ from the defaults", _parameters(subjects)),
        ("versions", "Versions", _versions(subjects)),
    )
    links = "".join(f'<a href="#{name}">{heading.split(" that ")[0]}</a>' for name, heading, _ in sections)
    body = "".join(f'<section id="{name}"><h2>{heading}</h2>{content}</section>' for name, heading, content in sections)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"/>'
        '<meta name="viewport" content="width=device-width, initial-scale=1"/>'
        f"<title>Report: {title}</title><style>{STYLE}</style></head>\n"
        f"<body><h1>{title}</h1>{_introduction(subjects)}<nav>{links}</nav>\n{body}</body></html>\n"
    )


def _introduction(subjects: Sequence[Subject]) -> str:
    counted = time_label(subjects).removesuffix(" [s]")
    words = [f"Times in pictures and timelines: {counted}."] if counted != "time" else []
    for subject in subjects:
        if not subject.run.complete:
            words.append(f"{subject.name} was cut off; what there is of it is shown.")
        if subject.run.dropped:
            words.append(f"{subject.name} lacks {subject.run.dropped} messages that its writer had to leave out.")
    return "".join(f'<p class="faint">{html.escape(text)}</p>' for text in words)


def _figures(subjects: Sequence[Subject]) -> str:
    names = "".join(f'<th class="number">{_name(subject)}</th>' for subject in subjects)
    lines = "".join(
        f"<tr><td>{html.escape(row.label)}</td>"
        + "".join(f'<td class="number">{html.escape(value)}</td>' for value in row.values)
        + "</tr>"
        for row in rows(subjects)
    )
    return _table(names, lines)


def _pictures(subjects: Sequence[Subject]) -> str:
    with drawing():
        return "".join(
            f'<figure><img alt="{html.escape(page.heading)}" src="data:image/svg+xml;base64,'
            f'{base64.b64encode(as_svg(page)).decode()}"/>'
            f"<figcaption>{html.escape(page.heading)}: {html.escape(page.about)}</figcaption></figure>\n"
            for page in pages(subjects)
        )


def _timeline(subject: Subject, named: bool) -> str:
    every = entries(subject)
    strip = "".join(
        f'<div title="{html.escape(_words(entry))}" '
        f'style="flex:{max(entry.duration_s, 0.0):.6f};background:{MODE_COLOURS[entry.mode]}"></div>'
        for entry in every
    )
    lines = "".join(
        f'<tr><td class="number">{entry.number}</td><td class="number">{entry.begin_s:.3f}</td>'
        f'<td class="number">{entry.duration_s:.3f}</td><td>{_badge(entry)}</td>'
        f"<td>{entry.level.name}</td><td>{html.escape(entry.reason)}</td></tr>"
        for entry in every
    )
    head = (
        '<tr><th class="number">no.</th><th class="number">from [s]</th><th class="number">for [s]</th>'
        "<th>mode</th><th>level</th><th>reason</th></tr>"
    )
    heading = f"<h3>{_name(subject)}</h3>" if named else ""
    return (
        f'{heading}<div class="strip">{strip}</div>'
        f'<div class="box"><table class="states"><thead>{head}</thead><tbody>{lines}</tbody></table></div>'
    )


def _words(entry: Entry) -> str:
    return f"{entry.number}: {entry.begin_s:.2f} s, {entry.mode.value}: {entry.reason}"


def _badge(entry: Entry) -> str:
    ink = INK if entry.mode in DARK_TEXT else "#fff"
    return f'<span class="mode" style="background:{MODE_COLOURS[entry.mode]};color:{ink}">{entry.mode.value}</span>'


def _parameters(subjects: Sequence[Subject]) -> str:
    """At the start; a row that differs between the recordings is marked. Changes on the way are listed beneath."""
    lines = []
    for parameter in describe():
        values = [subject.run.settings.get(parameter.name) for subject in subjects]
        if all(value is None or value == parameter.default for value in values):
            continue
        differs = ' class="differs"' if any(value != values[0] for value in values) else ""
        unit = f" [{parameter.unit}]" if parameter.unit else ""
        cells = "".join(f'<td class="long">{_value(value)}</td>' for value in (parameter.default, *values))
        about = html.escape(parameter.description)
        lines.append(f'<tr{differs}><td title="{about}">{html.escape(parameter.name + unit)}</td>{cells}</tr>')
    names = "".join(f"<th>{_name(subject)}</th>" for subject in subjects)
    table = (
        f"<table><thead><tr><th>parameter</th><th>default</th>{names}</tr></thead><tbody>{''.join(lines)}</tbody></table>"
        if lines
        else "<p>None.</p>"
    )
    return f'<div class="wide">{table}</div>' + "".join(_changes(subject, subject.run) for subject in subjects)


def _changes(subject: Subject, run: Run) -> str:
    if not run.setting_changes:
        return ""
    lines = "".join(
        f'<tr><td class="number">{time_s - subject.zero_s:.3f}</td><td>{html.escape(name)}</td>'
        f'<td class="long">{_value(value)}</td></tr>'
        for time_s, changed in run.setting_changes
        for name, value in changed.items()
    )
    head = '<tr><th class="number">at [s]</th><th>parameter</th><th>new value</th></tr>'
    return f"<h3>Changed during {_name(subject)}</h3><table><thead>{head}</thead><tbody>{lines}</tbody></table>"


def _value(value: Value | None) -> str:
    if value is None:
        return "not recorded"
    listed = isinstance(value, tuple)
    text = ", ".join(map(_number, value)) if isinstance(value, tuple) else _number(value)
    shown = text if len(text) <= MOST_CHARACTERS else f"{text[:MOST_CHARACTERS]}... ({len(text)} characters)"
    return html.escape(shown) or ("none" if listed else "empty")


def _number(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _versions(subjects: Sequence[Subject]) -> str:
    lines = []
    for key in dict.fromkeys(key for subject in subjects for key in subject.run.versions):
        values = [subject.run.versions.get(key, NONE) for subject in subjects]
        differs = ' class="differs"' if len(set(values)) > 1 else ""
        cells = "".join(f"<td>{html.escape(value)}</td>" for value in values)
        lines.append(f"<tr{differs}><td>{html.escape(key)}</td>{cells}</tr>")
    names = "".join(f"<th>{_name(subject)}</th>" for subject in subjects)
    return _table(names, "".join(lines))


def _table(names: str, lines: str) -> str:
    """A row per figure, a column per recording."""
    return f'<div class="wide"><table><thead><tr><th></th>{names}</tr></thead><tbody>{lines}</tbody></table></div>'


def _name(subject: Subject) -> str:
    return f'<span class="dot" style="background:{subject.colour}"></span>{html.escape(subject.name)}'
