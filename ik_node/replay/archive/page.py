"""The table of an archive as one HTML page that sorts by every column; each row opens its report."""

from __future__ import annotations

import html
from collections.abc import Sequence

from ik_node.replay.archive.row import BROKEN, DIFFERENT, BagRow
from ik_node.report.style import AMBER, GREEN, RED
from ik_node.report.verdict import CAUSE_COLOURS, Cause

STYLE = """
body { font: 14px/1.45 system-ui, sans-serif; color: #222; margin: 0; padding: 16px 24px 48px; }
h1 { font-size: 1.4em; margin: 8px 0; } p { margin: 4px 0 12px; color: #556; }
.wide { overflow: auto; max-height: 85vh; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; min-width: 100%; }
th, td { text-align: left; padding: 4px 14px 4px 0; border-bottom: 1px solid #e6e8ea; vertical-align: top; }
th { cursor: pointer; white-space: nowrap; user-select: none; position: sticky; top: 0; background: #fff; }
th[aria-sort="ascending"]::after { content: " \\25B2"; } th[aria-sort="descending"]::after { content: " \\25BC"; }
td.number, th.number { text-align: right; } td.number, td.date { white-space: nowrap; } a { color: #0072b2; }
td.verdict { border-left-width: 6px; border-left-style: solid; padding-left: 8px; min-width: 260px; }
@media (max-width: 640px) { body { padding: 8px 12px 32px; } }
"""
SCRIPT = """
document.querySelectorAll("th").forEach((head, column) => head.addEventListener("click", () => {
  const body = document.querySelector("tbody");
  const up = head.getAttribute("aria-sort") !== "ascending";
  document.querySelectorAll("th").forEach(other => other.removeAttribute("aria-sort"));
  head.setAttribute("aria-sort", up ? "ascending" : "descending");
  const value = row => row.cells[column].dataset.value ?? row.cells[column].textContent;
  const rows = [...body.rows].sort((one, two) => {
    const a = value(one), b = value(two);
    if (a === "" || b === "") return (a === "") - (b === "");
    const order = head.classList.contains("number") ? a - b : a.localeCompare(b, undefined, { numeric: true });
    return up ? order : -order;
  });
  body.append(...rows);
}));
"""


def as_page(rows: Sequence[BagRow], reports: Sequence[str], total: int | None = None) -> str:
    """The content of the file.

    Args:
        rows: The table. Texts from recordings are escaped.
        reports: Relative address of the report of each row; empty for none.
        total: Number of recordings, of which the rows may be a part; default: all.
    """
    runs = tuple(dict.fromkeys(name for row in rows for name in row.what_if))
    heads = [
        "<th>bag</th><th>verdict</th>",
        *(f'<th class="number">{name}</th>' for name in ("RMS [mm]", "max [mm]", "slowed [s]")),
        "<th>worst limit</th><th>replay</th>",
        *(f"<th>{name}</th>" for name in ("robot", "method", "version", "recorded")),
        *(f'<th class="number">what if {html.escape(name)}: RMS [mm]</th>' for name in runs),
    ]
    lines = "".join(_line(row, report, runs) for row, report in zip(rows, reports, strict=True))
    failed = sum(bool(row.error) for row in rows)
    number = f"{len(rows)}" if total in (None, len(rows)) else f"{len(rows)} of {total}"
    summary = f"{number} recordings" + (f", {failed} with an error" if failed else "")
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"/>'
        '<meta name="viewport" content="width=device-width, initial-scale=1"/>'
        f"<title>{summary}</title><style>{STYLE}</style></head>\n<body><h1>{summary}</h1>"
        "<p>A click on a column sorts by it; the name of a recording opens its report.</p>"
        f'<div class="wide"><table><thead><tr>{"".join(heads)}</tr></thead><tbody>\n{lines}</tbody></table></div>'
        f"<script>{SCRIPT}</script></body></html>\n"
    )


def _line(row: BagRow, report: str, runs: Sequence[str]) -> str:
    name = html.escape(row.bag)
    link = f'<a href="{html.escape(report, quote=True)}">{name}</a>' if report else name
    replayed = row.replay + (f": {row.first_difference}" if row.first_difference else "")
    cells = [
        f"<td>{link}</td>",
        f'<td class="verdict" style="border-left-color:{_colour(row)}">{html.escape(row.verdict or row.error)}</td>',
        *(_number(value) for value in (row.position_rms_mm, row.position_max_mm, row.slowed_s)),
        f"<td>{html.escape(row.worst_limit)}</td>",
        f"<td>{html.escape(f'{replayed}: {row.error}' if row.error and row.verdict else replayed)}</td>",
        f"<td>{html.escape(row.robot)}</td><td>{html.escape(row.method)}</td>",
        f'<td title="{html.escape(row.version, quote=True)}">{html.escape(row.version.partition(" ")[0])}</td>',
        f'<td class="date">{html.escape(row.recorded_utc)}</td>',
        *(_number(row.what_if.get(run, {}).get("position_rms_mm")) for run in runs),
    ]
    return f"<tr>{''.join(cells)}</tr>\n"


def _colour(row: BagRow) -> str:
    if row.replay in (BROKEN, DIFFERENT) or row.error:
        return RED
    return CAUSE_COLOURS.get(Cause(row.cause), AMBER) if row.cause else GREEN


def _number(value: float | None) -> str:
    if value is None:
        return '<td class="number" data-value="">-</td>'
    return f'<td class="number" data-value="{value!r}">{value:.3f}</td>'
