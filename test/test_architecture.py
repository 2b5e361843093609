"""Structure of the package: folders, direction of imports, and files that must agree with each other."""

from __future__ import annotations

import ast
import importlib
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import yaml
from support import PROJECT

import ik_node
from ik_node.control.controller import Controller
from ik_node.robot.catalogue import robot_from_settings
from ik_node.settings.groups import Settings, describe
from ik_node.settings.parameter_file import read_settings

PACKAGE = PROJECT / "ik_node"
DOCS = PROJECT / "docs"
MODULES = sorted(PACKAGE.rglob("*.py"))
FLOORS = (
    ("cli",),
    ("ros",),
    ("replay", "viewer"),
    ("report",),
    ("trajectory",),
    ("recording",),
    ("control",),
    ("differential_ik", "messages", "targets"),
    ("collision", "inverse_kinematics"),
    ("robot",),
    ("interfaces",),
    ("math", "resources", "settings"),
    ("jit",),
    ("dependencies",),
    ("errors",),
)
"""Every folder and loose file of the package, top floor first. A module imports from its own folder and from the floors
below it; folders of one floor do not import each other."""
FLOOR = {room: number for number, floor in enumerate(FLOORS) for room in floor}
MAX_LINES = 400
ROS = re.compile(r"^(rclpy|builtin_interfaces|tf2_ros|.*_(msgs|interfaces)|std_srvs)(\.|$)")


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(PROJECT).with_suffix("").parts).removesuffix(".__init__")


@cache
def imports(path: Path) -> frozenset[str]:
    """Every module that ``path`` imports, wherever in the file."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(found)


def room_of(module: str) -> str:
    """Folder or loose file of a module of the package; empty for the package itself."""
    return module.split(".")[1] if module.startswith("ik_node.") else ""


ROOMS = [path for path in MODULES if room_of(name_of(path))]
"""All modules but ``ik_node/__init__.py``, which imports lazily what it exports."""


def test_every_module_is_on_a_floor() -> None:
    loose = {path.name for path in PACKAGE.iterdir() if path.is_file()}
    assert loose == {"__init__.py", "dependencies.py", "errors.py", "jit.py", "py.typed", "resources.py"}
    assert {room_of(name_of(path)) for path in ROOMS} == FLOOR.keys()


@pytest.mark.parametrize("path", ROOMS, ids=name_of)
def test_imports_run_downwards(path: Path) -> None:
    room = room_of(name_of(path))
    for module in imports(path):
        if ROS.match(module):
            assert room in ("ros", "cli"), f"{module} may be imported in ros/ and cli/ only"
        other = room_of(module)
        if other in FLOOR and other != room:
            assert FLOOR[other] > FLOOR[room], f"{name_of(path)} imports {module}, which is not below it"


def test_there_are_no_circular_imports() -> None:
    graph = {name_of(path): {m for m in imports(path) if room_of(m)} for path in ROOMS}
    done: set[str] = set()

    def visit(module: str, trail: tuple[str, ...]) -> None:
        assert module not in trail, f"circle: {' -> '.join((*trail, module))}"
        if module not in done:
            for other in sorted(graph.get(module, set()) & graph.keys()):
                if other != module:
                    visit(other, (*trail, module))
            done.add(module)

    for module in graph:
        visit(module, ())


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_modules_are_short(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= MAX_LINES


@pytest.mark.parametrize("folder", sorted({path.parent for path in ROOMS} - {PACKAGE}), ids=lambda path: path.name)
def test_every_folder_is_described(folder: Path) -> None:
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text()))
    assert text is not None
    assert len(text) > 200, "the docstring states the purpose of the folder and the flow of data"


def test_class_names_are_unique() -> None:
    names = Counter(
        node.name
        for path in MODULES
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef)
    )
    assert [name for name, count in names.items() if count > 1] == []


def test_tests_have_the_folders_of_the_package() -> None:
    folders = {path.parent.relative_to(PROJECT / "test").as_posix() for path in (PROJECT / "test").rglob("test_*.py")}
    package = {path.parent.relative_to(PACKAGE).as_posix() for path in ROOMS}
    assert folders - {".", "benchmarks", "examples", "faults", "fuzz", "jazzy"} <= package


def _private_names(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Attribute) and re.match(r"_[a-z]", node.attr):
            owner = node.value.id if isinstance(node.value, ast.Name) else ""
            if owner not in ("self", "cls") and node.attr not in ("_replace", "_asdict", "_fields"):
                yield f"{path.name}:{node.lineno} {node.attr}"
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith(("ik_node", "benchmarks")):
            yield from (f"{path.name}:{node.lineno} {alias.name}" for alias in node.names if alias.name[0] == "_")


def test_tests_use_public_names_and_no_benchmark() -> None:
    files = sorted((PROJECT / "test").rglob("*.py"))
    assert [name for path in files for name in _private_names(path)] == []
    assert [path.name for path in files if any(module.startswith("benchmarks") for module in imports(path))] == []


@pytest.mark.parametrize("path", [path for path in ROOMS if room_of(name_of(path)) not in ("cli", "ros")], ids=name_of)
def test_no_clock_is_read_below_ros(path: Path) -> None:
    tree = ast.parse(path.read_text())
    timed = {
        alias.asname or alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names
    }
    assert not timed & {"time", "datetime"}, "the time is an argument of each call"


def test_assert_is_for_tests() -> None:
    for path in MODULES:
        tree = ast.parse(path.read_text())
        assert not [node for node in ast.walk(tree) if isinstance(node, ast.Assert)], path


def test_the_version_is_the_same_everywhere() -> None:
    package = re.search(r"<version>(.*)</version>", (PROJECT / "package.xml").read_text())
    setup = re.search(r'version="(.*)"', (PROJECT / "setup.py").read_text())
    assert package is not None
    assert setup is not None
    assert package[1] == setup[1] == ik_node.__version__
    assert f"{ik_node.__version__} (" in (PROJECT / "CHANGELOG.rst").read_text()


def test_the_drawing_and_the_table_of_imports_are_current(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS))
    make = importlib.import_module("make_architecture")
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    assert make.page(text) == text, "run python docs/make_architecture.py"
    assert make.drawing() == (DOCS / "architecture.svg").read_text(encoding="utf-8")


def _defines(tree: ast.AST, names: list[str]) -> bool:
    """True if ``tree`` defines names[0], which defines names[1], and so on."""
    if not names:
        return True
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and node.name == names[0]:
            return _defines(node, names[1:])
        targets = [node.target] if isinstance(node, ast.AnnAssign) else getattr(node, "targets", [])
        if len(names) == 1 and any(isinstance(target, ast.Name) and target.id == names[0] for target in targets):
            return True
    return False


def test_names_in_the_architecture_document_exist() -> None:
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    names = {name for name in re.findall(r"`(\w+(?:\.\w+)+)`", text) if name.split(".")[0] in FLOOR}
    assert len(names) > 30
    for name in sorted(names):
        parts = name.split(".")
        depth = next((k for k in range(len(parts), 0, -1) if (PACKAGE.joinpath(*parts[:k])).is_dir()), 0)
        if depth == len(parts):
            continue
        module = PACKAGE.joinpath(*parts[: depth + 1]).with_suffix(".py")
        assert module.is_file(), name
        assert _defines(ast.parse(module.read_text(encoding="utf-8")), parts[depth + 1 :]), name


def test_every_executable_has_a_module_with_main() -> None:
    names = re.search(r"EXECUTABLES = \((.*?)\)", (PROJECT / "setup.py").read_text(), re.DOTALL)
    assert names is not None
    for name in re.findall(r'"(\w+)"', names[1]):
        assert "\ndef main(" in (PACKAGE / "cli" / f"{name}.py").read_text(), name


@pytest.mark.parametrize("path", sorted((PROJECT / "config").glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_configurations_fit_their_robots(path: Path) -> None:
    settings = read_settings(path)
    robot = robot_from_settings(settings.arm)
    Controller(robot, settings)
    tree = yaml.safe_load(path.read_text())["/**"]["ik_simulator"]["ros__parameters"]
    start = tree["initial_position"]
    assert len(start) == robot.n
    assert all(
        lower <= q <= upper for q, lower, upper in zip(start, robot.limits.lower, robot.limits.upper, strict=True)
    )


def test_a_page_lists_every_parameter_with_its_default() -> None:
    page = (PROJECT / "docs" / "parameters.md").read_text()
    for about in describe():
        default = about.default
        text = ", ".join(f"{x:g}" for x in default) if isinstance(default, tuple) else default
        text = f"{default:g}" if isinstance(default, float) else text
        row = f"| `{about.name}` | {str(text).lower() if isinstance(default, bool) else text or '-'} |"
        assert row in page, f"docs/parameters.md has no row that begins: {row}"
    assert set(Settings().flat()) == {about.name for about in describe()}
