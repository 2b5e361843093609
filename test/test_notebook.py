"""docs/notes.ipynb is that of docs/notes.md, and its code cells print their outputs."""

from __future__ import annotations

import contextlib
import io
import json
from typing import Any

import numpy as np
from support import PROJECT, loaded_program

DOCS = PROJECT / "docs"


def made() -> Any:
    return loaded_program(DOCS / "make_notebook.py")


def test_the_notebook_is_current() -> None:
    text = (DOCS / "notes.md").read_text(encoding="utf-8")
    current = (DOCS / "notes.ipynb").read_text(encoding="utf-8")
    assert current == made().notebook(text), "run python docs/make_notebook.py"


def test_the_notebook_has_the_fields_that_nbformat_4_5_requires() -> None:
    notebook = json.loads((DOCS / "notes.ipynb").read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    cells = notebook["cells"]
    assert len({cell["id"] for cell in cells}) == len(cells) > 40
    for cell in cells:
        assert cell["cell_type"] in ("markdown", "code")
        assert {"metadata", "source"} <= cell.keys()
        if cell["cell_type"] == "code":
            assert {"outputs", "execution_count"} <= cell.keys()


@np.printoptions()  # the notebook changes them
def test_the_cells_print_their_outputs_in_order() -> None:
    session: dict[str, Any] = {}
    compared = 0
    for cell in json.loads((DOCS / "notes.ipynb").read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "code" and not source.startswith("!"):
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                exec(compile(source, cell["id"], "exec"), session)
            assert printed.getvalue() == "".join("".join(output["text"]) for output in cell["outputs"])
            compared += bool(cell["outputs"])
    assert compared >= 20
