"""Writes docs/notes.ipynb from docs/notes.md: texts as Markdown cells, Python and commands as code cells.

The output that notes.md shows stands below each code cell, so that the notebook can be read without running it.
Run: python docs/make_notebook.py
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

PAGE = Path(__file__).with_name("notes.md")
NOTEBOOK = PAGE.with_suffix(".ipynb")
BLOCK = re.compile(r"^```(python|text|console)\n(.*?)^```\n?", re.DOTALL | re.MULTILINE)


def cells(text: str) -> list[dict[str, Any]]:
    """The cells of a page; a ``text`` block is the output of the code before it."""
    found: list[dict[str, Any]] = []
    end = 0
    for block in BLOCK.finditer(text):
        _add_markdown(found, text[end : block.start()])
        end = block.end()
        kind, body = block.groups()
        if kind == "python":
            found.append(_code(body))
        elif kind == "text":
            found[-1]["outputs"].append(_output(body))
        else:
            command, _, printed = body.partition("\n")
            found.append(_code(f"!{command.removeprefix('$ ')}\n"))
            found[-1]["outputs"].append(_output(printed))
    _add_markdown(found, text[end:])
    return [{"id": f"cell-{number}", **cell} for number, cell in enumerate(found)]


def notebook(text: str) -> str:
    """The notebook of a page as JSON (nbformat 4.5)."""
    metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    document = {"cells": cells(text), "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _add_markdown(found: list[dict[str, Any]], text: str) -> None:
    if text.strip():
        found.append({"cell_type": "markdown", "metadata": {}, "source": _lines(text.strip("\n"))})


def _code(body: str) -> dict[str, Any]:
    source = _lines(body.strip("\n"))
    return {"cell_type": "code", "execution_count": None, "metadata": {}, "outputs": [], "source": source}


def _output(body: str) -> dict[str, Any]:
    return {"name": "stdout", "output_type": "stream", "text": _lines(body)}


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


if __name__ == "__main__":
    NOTEBOOK.write_text(notebook(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
