"""Writes the table of parameters in the README anew from the settings: ``python docs/parameter_table.py``."""

from __future__ import annotations

from pathlib import Path

from ik_node.settings.groups import Descriptor, describe

README = Path(__file__).resolve().parent.parent / "README.md"
BEGIN, END = "<!-- parameters: begin -->\n", "<!-- parameters: end -->"


def row(about: Descriptor) -> str:
    """One parameter."""
    value = about.default
    if isinstance(value, tuple):
        default = ", ".join(str(entry) if isinstance(entry, str) else f"{entry:g}" for entry in value)
    elif isinstance(value, bool):
        default = str(value).lower()
    else:
        default = f"{value:g}" if isinstance(value, float) else str(value)
    low = "" if about.minimum is None else f"{about.minimum:g}"
    high = "" if about.maximum is None else f"{about.maximum:g}"
    valid = ", ".join(about.choices) or (f"{low or '-∞'} … {high or '∞'}" if low or high else "")
    fixed = " Read-only." if about.read_only else ""
    return f"| `{about.name}` | {default or '-'} | {about.unit} | {valid} | {about.description}{fixed} |\n"


def table() -> str:
    """The whole table."""
    head = "| parameter | default | unit | valid | meaning |\n|---|---|---|---|---|\n"
    return head + "".join(row(about) for about in describe())


def main() -> None:
    """Replaces what stands between the marks."""
    text = README.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    README.write_text(before + BEGIN + table() + END + rest.split(END)[1], encoding="utf-8")


if __name__ == "__main__":
    main()
