"""Writes docs/api.md from the docstrings of the names that ``ik_node`` exports: ``python docs/make_api.py``.

The source is parsed, not imported. A test compares docs/api.md with what this script makes.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

DOCS = Path(__file__).resolve().parent
PROJECT = DOCS.parent
API = DOCS / "api.md"
SECTIONS = {
    "Robots": ("load_robot", "Robot", "SimulatedArm"),
    "Inverse kinematics": ("solve_pose", "TaskTolerance", "task_rank", "resolve", "METHODS", "solve"),
    "Control": ("Settings", "Controller", "Instant", "JointSample", "PoseSample", "Step"),
    "Recordings": ("load_run",),
    "Errors": (),
}
"""Headings with their names in order; the last one takes the names that no other has."""
HEAD = """# API

Made from the docstrings by `python docs/make_api.py`. [The examples](../examples) are short scripts that use them.

"""
GOOGLE = {"Args": "Arguments", "Returns": "Returns", "Raises": "Raises", "Yields": "Yields", "Attributes": "Attributes"}
MAX_SIGNATURE = 100
Definition = ast.FunctionDef | ast.ClassDef | ast.AnnAssign


class Export(NamedTuple):
    """An exported name."""

    name: str
    module: str
    node: Definition
    docstring: str


def exports() -> dict[str, Export]:
    """Return every exported name with its definition, found by the imports in ``ik_node/__init__.py``."""
    found = {}
    for statement in ast.walk(_parse("ik_node")):
        if isinstance(statement, ast.ImportFrom) and (statement.module or "").startswith("ik_node."):
            names = {alias.name for alias in statement.names}
            for export in _definitions(str(statement.module)):
                if export.name in names:
                    found[export.name] = export
    return found


def page() -> str:
    """Return the text of docs/api.md."""
    known = exports()
    placed = {name for names in SECTIONS.values() for name in names}
    *_, last = SECTIONS
    sections = {**SECTIONS, last: tuple(sorted(known.keys() - placed))}
    parts = [HEAD, markdown(ast.get_docstring(_parse("ik_node")) or ""), "\n"]
    for heading, names in sections.items():
        parts.append(f"\n## {heading}\n")
        parts += [_entry(known[name]) for name in names]
    return re.sub(r"\n{3,}", "\n\n", "".join(parts)).rstrip() + "\n"


def markdown(docstring: str) -> str:
    """Return a Google-style docstring, with reStructuredText roles, as Markdown."""
    lines: list[str] = []
    section = ""
    for line in docstring.splitlines():
        title = line.removesuffix(":")
        if line.endswith(":") and title in GOOGLE:
            section = title
            lines += ["", f"{GOOGLE[title]}:", ""]
        elif section and line.startswith("    "):
            text = line[4:]
            if text.startswith("    ") or not text:
                lines.append(f"  {text.strip()}")
            else:
                name, colon, rest = text.partition(": ")
                is_item = section != "Returns" and colon and re.fullmatch(r"[\w*, .\[\]]+( \(.*\))?", name)
                lines.append(f"- `{name}`: {rest}" if is_item else f"- {text}" if _starts_item(lines) else f"  {text}")
        else:
            section = section if not line else ""
            lines.append(line)
    return _inline(_code_blocks("\n".join(lines)))


def _starts_item(lines: list[str]) -> bool:
    return not lines or not lines[-1].strip()


def _code_blocks(text: str) -> str:
    """Fence what ``::`` introduces."""
    out: list[str] = []
    is_introduced = is_fenced = False
    for line in text.splitlines():
        if is_fenced and line and not line.startswith("    "):
            out += _closed(out)
            is_fenced = False
        if is_introduced and line.startswith("    "):
            out.append("```")
            is_introduced, is_fenced = False, True
        if line.endswith("::"):
            is_introduced = True
            out.append(line.removesuffix("::") + (":" if line != "::" else ""))
        else:
            out.append(line[4:] if is_fenced else line)
    return "\n".join(out + (_closed(out) if is_fenced else []))


def _closed(out: list[str]) -> list[str]:
    blanks = 0
    while out and not out[-1]:
        out.pop()
        blanks += 1
    return ["```", *[""] * max(blanks, 1)]


def _inline(text: str) -> str:
    """Replace roles and double backquotes outside fenced blocks."""
    parts = re.split(r"(```.*?```)", text, flags=re.DOTALL)
    for index in range(0, len(parts), 2):
        part = re.sub(r":(\w+):`~?(?:[\w.]*\.)?(\w+)`", r"`\2`", parts[index])
        parts[index] = re.sub(r"``([^`]+)``", r"`\1`", part)
    return "".join(parts)


def _entry(export: Export) -> str:
    node = export.node
    text = f"\n### {export.name}\n\n`{export.module}`\n\n"
    if isinstance(node, ast.FunctionDef):
        return f"{text}{_fence(_signature(node))}{markdown(export.docstring)}\n"
    if isinstance(node, ast.AnnAssign):
        return f"{text}{markdown(export.docstring)}\n"
    bases = ", ".join(ast.unparse(base) for base in node.bases)
    text += f"{markdown(export.docstring)}\n"
    if export.module == "ik_node.errors":
        return f"{text}\nBases: `{bases}`\n"
    rows = list(_fields(node))
    if rows:
        text += "\n| field | type | |\n|---|---|---|\n" + "".join(rows)
    return text + "".join(_method(item) for item in node.body if isinstance(item, ast.FunctionDef))


def _fields(node: ast.ClassDef) -> Iterator[str]:
    for name, annotation, docstring in _annotated(node.body):
        kind, about = ast.unparse(annotation), docstring
        if isinstance(annotation, ast.Subscript) and ast.unparse(annotation.value) == "Annotated":
            items = annotation.slice.elts if isinstance(annotation.slice, ast.Tuple) else []
            kind, about = ast.unparse(items[0]), _described(items[1]) or docstring
        if not name.startswith("_"):
            yield f"| `{name}` | `{kind}` | {_inline(' '.join(about.split()))} |\n".replace("||", "\\|\\|")


def _described(annotation: ast.expr) -> str:
    """Return description, unit and frame from ``Quantity(kind, description, unit, frame)``."""
    arguments = annotation.args[1:] if isinstance(annotation, ast.Call) else []
    description, unit, frame = (*(str(ast.literal_eval(argument)) for argument in arguments), "", "", "")[:3]
    return description + (f" [{unit}]" if unit else "") + (f" In {{{frame}}}." if frame else "")


def _method(node: ast.FunctionDef) -> str:
    docstring = ast.get_docstring(node) or ""
    if node.name.startswith("_") and not (node.name == "__init__" and docstring):
        return ""
    decorators = {ast.unparse(decorator) for decorator in node.decorator_list}
    if "property" in decorators:
        kind = f" -> {ast.unparse(node.returns)}" if node.returns else ""
        return f"\n#### `{node.name}`{' (property)'}\n\n{_fence(node.name + kind)}{markdown(docstring)}\n"
    return f"\n#### `{node.name}`\n\n{_fence(_signature(node))}{markdown(docstring)}\n"


def _signature(node: ast.FunctionDef) -> str:
    items: list[str] = []
    arguments = node.args
    for argument, default in zip(
        arguments.args[::-1], [*arguments.defaults[::-1], *[None] * len(arguments.args)], strict=False
    ):
        items.insert(0, _argument(argument, default))
    items = items[1:] if items and items[0] in ("self", "cls") else items
    if arguments.vararg or arguments.kwonlyargs:
        items.append(f"*{arguments.vararg.arg if arguments.vararg else ''}")
    items += [_argument(*pair) for pair in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)]
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    one_line = f"{node.name}({', '.join(items)}){returns}"
    if len(one_line) <= MAX_SIGNATURE:
        return one_line
    return f"{node.name}(\n" + "".join(f"    {item},\n" for item in items) + f"){returns}"


def _argument(argument: ast.arg, default: ast.expr | None) -> str:
    kind = f": {ast.unparse(argument.annotation)}" if argument.annotation else ""
    value = "" if default is None else f"{' = ' if kind else '='}{ast.unparse(default)}"
    return f"{argument.arg}{kind}{value}"


def _fence(code: str) -> str:
    return f"```python\n{code}\n```\n\n"


def _annotated(body: list[ast.stmt]) -> Iterator[tuple[str, ast.expr, str]]:
    """Yield annotated assignments as (name, annotation, the string that follows)."""
    for statement, after in zip(body, [*body[1:], ast.Pass()], strict=True):
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            is_text = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            text = str(after.value.value) if is_text else ""  # type: ignore[attr-defined]
            yield statement.target.id, statement.annotation, text


def _definitions(module: str) -> Iterator[Export]:
    body = _parse(module).body
    texts = {name: text for name, _, text in _annotated(body)}
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield Export(node.name, module, node, ast.get_docstring(node) or "")
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield Export(node.target.id, module, node, texts[node.target.id])


def _parse(module: str) -> ast.Module:
    path = PROJECT.joinpath(*module.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return ast.parse(file.read_text(encoding="utf-8"))


def main() -> None:
    """Write the page."""
    API.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
