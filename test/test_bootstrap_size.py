"""What bootstrap.py removes from the environment, and that nothing that is read is removed."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote

import daqp
import pytest
from support import PROJECT, loaded_program

from ik_node.robot.catalogue import robots_folder


@pytest.fixture(scope="module")
def bootstrap() -> ModuleType:
    return loaded_program(PROJECT / "bootstrap.py")


def test_every_mesh_that_a_urdf_names_is_kept(bootstrap: ModuleType) -> None:
    robots = robots_folder()
    removed = {path.name.lower() for path in bootstrap.unnamed_meshes(robots)}
    named = [
        unquote(name)
        for urdf in robots.rglob("*.urdf")
        for name in re.findall(r"<mesh[^>]*filename\s*=\s*[\"']([^\"']+)", urdf.read_text(errors="replace"))
    ]
    assert len(named) > 1000
    assert [name for name in named if Path(name).name.lower() in removed] == []


def test_meshes_without_a_name_in_a_description_are_found(bootstrap: ModuleType, tmp_path: Path) -> None:
    for name in ("used.stl", "Other.DAE", "with space.obj", "unused.stl", "unused.dae", "texture.png"):
        (tmp_path / name).touch()
    (tmp_path / "arm.urdf").write_text(
        '<mesh filename="package://arm/used.stl"/><mesh filename="package://arm/other.dae"/>'
        "<mesh filename='with%20space.obj'/>"
    )
    found = sorted(path.name for path in bootstrap.unnamed_meshes(tmp_path))
    assert found == ["unused.dae", "unused.stl"]


def test_identical_files_become_one(bootstrap: ModuleType, tmp_path: Path) -> None:
    large = b"library" * bootstrap.MIN_LINKED_BYTES
    contents = {"liba.so": large, "liba.so.1": large, "libb.so": large + b"b", "small": b"small", "small2": b"small"}
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    for _ in range(2):
        bootstrap.link_identical_files(tmp_path)
        assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == contents
        links = {name: (tmp_path / name).stat().st_nlink for name in contents}
        assert links == {"liba.so": 2, "liba.so.1": 2, "libb.so": 1, "small": 1, "small2": 1}


def test_what_is_not_run_is_removed_and_libraries_still_load(bootstrap: ModuleType, tmp_path: Path) -> None:
    site = tmp_path / "lib" / "python3.11" / "site-packages"
    for folder in ("numpy/linalg/tests", "other/tests", "cmeel.prefix/share/cmake", "cmeel.prefix/lib"):
        (site / folder).mkdir(parents=True)
    (site / "cmeel.prefix" / "lib" / "libz.a").touch()
    library = Path(shutil.copy(daqp.__file__, site))
    size = library.stat().st_size
    bootstrap.make_small(tmp_path)
    left = sorted(path.relative_to(site).as_posix() for path in site.rglob("*"))
    folders = [
        "cmeel.prefix",
        "cmeel.prefix/lib",
        "cmeel.prefix/share",
        "numpy",
        "numpy/linalg",
        "other",
        "other/tests",
    ]
    assert left == sorted([*folders, library.name])
    assert library.stat().st_size <= size
    code = f"import sys; sys.path.insert(0, {str(site)!r}); import daqp; print(daqp.__file__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == str(library), done.stderr
