"""Writes the table of docs/parameters.md from the settings: ``python docs/make_parameter_table.py``."""

from __future__ import annotations

from pathlib import Path

from ik_node.settings.groups import describe
from ik_node.settings.schema import Descriptor

PAGE = Path(__file__).resolve().parent / "parameters.md"
BEGIN, END = "<!-- parameters: begin -->\n", "<!-- parameters: end -->"


def row(about: Descriptor) -> str:
    """The table row of one parameter."""
    default, read_only = about.default_text or "-", " Read-only." if about.read_only else ""
    return f"| `{about.name}` | {default} | {about.unit} | {about.valid_text} | {about.description}{read_only} |\n"


def table() -> str:
    """The whole table."""
    head = "| parameter | default | unit | valid | meaning |\n|---|---|---|---|---|\n"
    return head + "".join(row(about) for about in describe())


def main() -> None:
    """Replaces the table between the marks on the page."""
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    PAGE.write_text(before + BEGIN + table() + END + rest.split(END)[1], encoding="utf-8")


if __name__ == "__main__":
    main()
