"""docs/api.md agrees with the docstrings of the exported names."""

from __future__ import annotations

import sys

from support import PROJECT

import ik_node

sys.path.insert(0, str(PROJECT / "docs"))

import make_api


def test_the_page_is_current() -> None:
    assert make_api.API.read_text(encoding="utf-8") == make_api.page(), "run: python docs/make_api.py"


def test_the_page_has_every_exported_name_with_a_docstring() -> None:
    exports = make_api.exports()
    assert set(exports) == set(ik_node.__all__)
    assert not [name for name, export in exports.items() if not export.docstring]


def test_google_sections_become_lists() -> None:
    text = make_api.markdown(
        "Solve ``A x = b``; see :func:`a.b.c`.\n\nArgs:\n    a: Matrix, (n, n),\n        regular.\n    b: Vector.\n\n"
        "Returns:\n    x, (n,).\n\nRaises:\n    ValueError: ``a`` is singular.\n"
    )
    assert "`A x = b`; see `c`" in text
    assert "- `a`: Matrix, (n, n),\n  regular.\n- `b`: Vector." in text
    assert "Returns:\n\n- x, (n,)." in text
    assert "- `ValueError`: `a` is singular." in text


def test_literal_blocks_are_fenced() -> None:
    assert make_api.markdown("As in::\n\n    y = a x\n\nwith a.") == "As in:\n\n```\ny = a x\n```\n\nwith a."
