"""Draws the folders of the package and their imports: ``python docs/make_architecture.py``.

Writes docs/architecture.svg and the table in docs/architecture.md. Both follow from the imports of the code, from the
first sentence of each folder's documentation, and from the table of floors in test/test_architecture.py.
"""

from __future__ import annotations

import ast
import sys
from html import escape
from pathlib import Path
from typing import NamedTuple

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent / "test"))

from test_architecture import FLOOR, FLOORS, PACKAGE, ROOMS, imports, name_of, room_of  # noqa: E402

BEGIN, END = "<!-- imports: begin -->\n", "<!-- imports: end -->"

LOOSE = ("jit", "dependencies", "errors")
COLUMNS = {
    "cli": (0, 4),
    "ros": (0, 4),
    "viewer": (0, 1),
    "replay": (2, 2),
    "report": (0, 1),
    "recording": (0, 0),
    "control": (1, 2),
    "messages": (0, 0),
    "differential_ik": (1, 1),
    "targets": (2, 2),
    "collision": (0, 1),
    "inverse_kinematics": (2, 2),
    "robot": (0, 2),
    "trajectory": (3, 3),
    "interfaces": (0, 1),
    "math": (0, 1),
    "settings": (2, 2),
    "resources": (4, 4),
    "jit": (0, 0),
    "dependencies": (0, 0),
    "errors": (1, 4),
}
"""First and last column of each room in the drawing; its row is its floor."""
GROUPS = {
    "executables and ROS": ("#fdeedd", ("cli", "ros")),
    "recorded runs": ("#e6f2e6", ("viewer", "replay", "report", "recording", "messages")),
    "control": ("#e3ecf7", ("control", "differential_ik", "targets", "collision", "inverse_kinematics", "robot")),
    "common": ("#f1f1f1", ("trajectory", "interfaces", "math", "settings", "resources", *LOOSE)),
}
"""Group -> colour, rooms."""
WIDTH, COLUMN, GUTTER, MARGIN, GAP = 1220, 220, 20, 20, 26
TITLE, LINE, PADDING, CHARACTER = 24, 15, 10, 6.5


class Box(NamedTuple):
    """Position of a room in the drawing, px."""

    x: float
    y: float
    width: float
    height: float


def imported_rooms() -> dict[str, list[str]]:
    """Room -> the rooms that it imports from, in the order of the floors."""
    order = list(FLOOR)
    found: dict[str, set[str]] = {room: set() for room in order}
    for path in ROOMS:
        room = room_of(name_of(path))
        found[room] |= {room_of(module) for module in imports(path)} & FLOOR.keys() - {room}
    return {room: sorted(rooms, key=order.index) for room, rooms in found.items()}


def without_implied(used: dict[str, list[str]]) -> dict[str, list[str]]:
    """The imports that do not follow from a chain of others (transitive reduction)."""
    below: dict[str, set[str]] = {}
    for room in reversed(list(used)):
        below[room] = set(used[room]).union(*(below[other] for other in used[room]))
    return {
        room: [other for other in rooms if not any(other in below[between] for between in rooms)]
        for room, rooms in used.items()
    }


def purpose(room: str) -> str:
    """The first sentence of a room's documentation."""
    folder, file = PACKAGE / room / "__init__.py", PACKAGE / f"{room}.py"
    text = ast.get_docstring(ast.parse((folder if folder.exists() else file).read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split()).replace("``", "")


def drawing() -> str:
    """The floors as rows of boxes, top floor first, with arrows from each room to those that it imports from."""
    boxes = _boxes()
    height = max(box.y + box.height for box in boxes.values()) + 2 * GAP
    colours = {room: colour for colour, rooms in GROUPS.values() for room in rooms}
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:.0f}" font-family="sans-serif">',
        '<defs><marker id="head" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0,0 L8,4 L0,8 z" fill="#4a6a8a"/></marker></defs>',
        f'<rect width="{WIDTH}" height="{height:.0f}" fill="#ffffff"/>',
    ]
    for room, (x, y, width, box_height) in boxes.items():
        parts += [
            f'<rect x="{x}" y="{y}" width="{width}" height="{box_height}" rx="6" fill="{colours[room]}" '
            'stroke="#4a6a8a"/>',
            f'<text x="{x + PADDING}" y="{y + 21}" font-size="16" font-weight="bold">{room}</text>',
        ]
        parts += [
            f'<text x="{x + PADDING}" y="{y + TITLE + 13 + LINE * line}" font-size="12" fill="#333333">'
            f"{escape(text)}</text>"
            for line, text in enumerate(_wrapped(purpose(room), width))
        ]
    for room, others in without_implied(imported_rooms()).items():
        parts += [
            f'<path d="{_arrow(room, other, boxes)}" fill="none" stroke="#4a6a8a" stroke-width="1.4" '
            'marker-end="url(#head)"/>'
            for other in others
        ]
    x = float(MARGIN)
    for name, (colour, _) in GROUPS.items():
        parts += [
            f'<rect x="{x:.0f}" y="{height - 24:.0f}" width="14" height="14" fill="{colour}" stroke="#4a6a8a"/>',
            f'<text x="{x + 20:.0f}" y="{height - 12:.0f}" font-size="12">{name}</text>',
        ]
        x += 48 + 7 * len(name)
    caption = "Arrow: imports from. Imports that follow from a chain of arrows are not drawn."
    parts.append(f'<text x="{x + 10:.0f}" y="{height - 12:.0f}" font-size="12">{caption}</text>')
    return "\n".join([*parts, "</svg>"]) + "\n"


def _boxes() -> dict[str, Box]:
    boxes, y = {}, float(MARGIN)
    for floor in FLOORS:
        widths = {room: COLUMN + (COLUMNS[room][1] - COLUMNS[room][0]) * (COLUMN + GUTTER) for room in floor}
        lines = max(len(_wrapped(purpose(room), widths[room])) for room in floor)
        height = TITLE + LINE * lines + PADDING
        for room in floor:
            boxes[room] = Box(_left(COLUMNS[room][0]), y, widths[room], height)
        y += height + GAP
    return boxes


def _left(column: int) -> float:
    return MARGIN + column * (COLUMN + GUTTER)


def _arrow(room: str, other: str, boxes: dict[str, Box]) -> str:
    """SVG path from the lower edge of ``room`` to the upper edge of ``other``: straight down, or with one step."""
    start = boxes[room].y + boxes[room].height
    end = boxes[other].y
    (first, last), (other_first, other_last) = COLUMNS[room], COLUMNS[other]
    between = [name for name, box in boxes.items() if start < box.y < end]
    for column in range(max(first, other_first), min(last, other_last) + 1):
        if not any(COLUMNS[name][0] <= column <= COLUMNS[name][1] for name in between):
            x = _left(column) + COLUMN / 2
            return f"M{x},{start} V{end}"
    if between:
        raise SystemExit(f"the arrow {room} -> {other} crosses {', '.join(between)}: change COLUMNS")
    column, other_column = (first, other_last) if first > other_last else (last, other_first)
    inwards = 40 if first > other_last else -40
    x, other_x = _left(column) + COLUMN / 2 - inwards, _left(other_column) + COLUMN / 2 + inwards
    return f"M{x},{start} V{start + GAP / 2} H{other_x} V{end}"


def _wrapped(text: str, width: float) -> list[str]:
    """``text`` in lines that fit into a box of ``width`` px."""
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + 1 + len(word) > (width - 2 * PADDING) / CHARACTER:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def table() -> str:
    """Floor, room, purpose, imports."""
    used = imported_rooms()
    rows = [
        f"| {number} | `{room}` | {purpose(room)} | {', '.join(used[room]) or '-'} |\n"
        for number, floor in enumerate(FLOORS, 1)
        for room in floor
    ]
    return "| floor | folder or module | purpose | imports from |\n|---|---|---|---|\n" + "".join(rows)


def page(text: str) -> str:
    """docs/architecture.md with the table of the imports as they are."""
    before, rest = text.split(BEGIN)
    return before + BEGIN + table() + END + rest.split(END)[1]


def main() -> None:
    """Writes both files."""
    path = DOCS / "architecture.md"
    path.write_text(page(path.read_text(encoding="utf-8")), encoding="utf-8")
    (DOCS / "architecture.svg").write_text(drawing(), encoding="utf-8")


if __name__ == "__main__":
    main()
