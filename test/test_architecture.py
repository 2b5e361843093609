"""The direction of imports, and that the package's files say the same: what keeps the house in order."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
import yaml
from support import PROJECT

import ik_node
from ik_node.control.controller import Controller
from ik_node.robot.catalogue import robot_from
from ik_node.settings.groups import Settings, describe
from ik_node.settings.parameter_file import read_settings

PACKAGE = PROJECT / "ik_node"
MODULES = sorted(PACKAGE.rglob("*.py"))
ROS = re.compile(r"^(rclpy|builtin_interfaces|tf2_ros|.*_(msgs|interfaces)|std_srvs)(\.|$)")
CLOCKS = re.compile(r"\b(time|monotonic|monotonic_ns|perf_counter|time_ns|now|today)\(")


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(PROJECT).with_suffix("").parts).removesuffix(".__init__")


def imports(path: Path) -> set[str]:
    """Every module that ``path`` imports, wherever in the file."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def layer(module: str) -> str:
    """``ros``, ``cli`` or ``core``."""
    part = module.split(".")[1:2]
    return part[0] if part and part[0] in ("ros", "cli") else "core"


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_imports_run_one_way(path: Path) -> None:
    mine = layer(name_of(path))
    for module in imports(path):
        if ROS.match(module):
            assert mine in ("ros", "cli"), f"{module} belongs into ros/"
        if module.startswith("ik_node."):
            theirs = layer(module)
            order = ("core", "ros", "cli")
            assert order.index(theirs) <= order.index(mine), f"{name_of(path)} imports {module}, which stands above it"


@pytest.mark.parametrize("path", [path for path in MODULES if layer(name_of(path)) == "core"], ids=name_of)
def test_no_clock_is_read_below_ros(path: Path) -> None:
    if path.parent.name == "benchmark":
        pytest.skip("measuring time is its purpose")
    tree = ast.parse(path.read_text())
    timed = {
        alias.asname or alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names
    }
    assert not timed & {"time", "datetime"}, "time is an argument"


def test_no_module_imports_itself_in_a_circle() -> None:
    graph = {name_of(path): {m for m in imports(path) if m.startswith("ik_node")} for path in MODULES}
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


def test_assert_is_for_tests() -> None:
    for path in MODULES:
        tree = ast.parse(path.read_text())
        assert not [node for node in ast.walk(tree) if isinstance(node, ast.Assert)], path


def test_the_version_is_the_same_everywhere() -> None:
    said = re.search(r"<version>(.*)</version>", (PROJECT / "package.xml").read_text())
    setup = re.search(r'version="(.*)"', (PROJECT / "setup.py").read_text())
    assert said is not None
    assert setup is not None
    assert said[1] == setup[1] == ik_node.__version__
    assert f"{ik_node.__version__} (" in (PROJECT / "CHANGELOG.rst").read_text()


def test_every_executable_has_a_module_with_main() -> None:
    names = re.search(r"EXECUTABLES = \((.*?)\)", (PROJECT / "setup.py").read_text(), re.DOTALL)
    assert names is not None
    for name in re.findall(r'"(\w+)"', names[1]):
        assert "\ndef main(" in (PACKAGE / "cli" / f"{name}.py").read_text(), name


@pytest.mark.parametrize("path", sorted((PROJECT / "config").glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_configurations_fit_their_robots(path: Path) -> None:
    settings = read_settings(path)
    robot = robot_from(settings.arm)
    Controller(robot, settings)
    tree = yaml.safe_load(path.read_text())["/**"]["ik_simulator"]["ros__parameters"]
    start = tree["initial_position"]
    assert len(start) == robot.n
    assert all(
        lower <= q <= upper for q, lower, upper in zip(start, robot.limits.lower, robot.limits.upper, strict=True)
    )


def test_the_readme_lists_every_parameter_with_its_default() -> None:
    readme = (PROJECT / "README.md").read_text()
    for about in describe():
        default = about.default
        said = ", ".join(f"{x:g}" for x in default) if isinstance(default, tuple) else default
        said = f"{default:g}" if isinstance(default, float) else said
        row = f"| `{about.name}` | {str(said).lower() if isinstance(default, bool) else said or '-'} |"
        assert row in readme, f"README has no row that begins: {row}"
    assert set(Settings().flat()) == {about.name for about in describe()}
