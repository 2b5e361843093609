"""Check that the numerical packages fit together, before they compute anything.

NumPy, SciPy, numba, Pinocchio and Coal exchange data by their binary interfaces. Packages of different installations (a
virtual environment, Debian's packages, a ROS workspace) may be imported without an error and fail in a computation, or
return wrong numbers.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
from functools import cache
from importlib import metadata
from itertools import pairwise
from pathlib import Path

from ik_node.errors import PackagesError

DISTRIBUTIONS = {"pinocchio": "pin"}
"""Package -> its name on the package index, where that is another one."""
COMPILED = ("numpy", "scipy.linalg.cython_blas", "scipy.linalg.cython_lapack", "numba")
"""What functions compiled by numba use; numba loads the linear algebra of SciPy at the first call only."""
ROBOTICS = ("numpy", "eigenpy", "coal", "pinocchio")
ONE_INSTALLATION = ("eigenpy", "coal", "pinocchio")
"""Packages that exchange C++ objects; those of two installations do not know each other's types."""


@cache
def check(modules: tuple[str, ...]) -> None:
    """Import modules that depend on each other.

    Args:
        modules: :data:`COMPILED` or :data:`ROBOTICS`.

    Raises:
        PackagesError: One is missing, does not fit the NumPy in use, or comes from another installation.
    """
    together = [name for name in modules if name in ONE_INSTALLATION and _folder(name)]
    for first, second in pairwise(together):
        if _folder(first) != _folder(second):
            raise PackagesError(f"{_described(first)} and {_described(second)} are of two installations")
    for module in modules:
        name = module.partition(".")[0]
        try:
            with contextlib.redirect_stderr(io.StringIO()):  # NumPy writes a page about modules built for NumPy 1
                importlib.import_module(module)
        except ModuleNotFoundError as error:
            raise PackagesError(f"package {error.name or name} is missing") from error
        except Exception as error:  # ImportError, ValueError, AttributeError, ...: any is possible
            reason = f"{type(error).__name__}: {error}"
            raise PackagesError(f"{_described(name)} does not fit {_described('numpy')}: {reason}") from error


def _folder(name: str) -> str:
    """Folder in which a package is installed; empty if it is not."""
    spec = importlib.util.find_spec(name)
    return str(Path(spec.origin).resolve().parents[1]) if spec is not None and spec.origin else ""


def _described(name: str) -> str:
    """Name, version and folder."""
    folder = _folder(name)
    listed = [folder, folder.partition("/cmeel.prefix/")[0]]  # of pip's packages with C++ libraries the second one
    found = metadata.distributions(name=DISTRIBUTIONS.get(name, name), path=listed)
    version = next((distribution.version for distribution in found), "")  # a ROS package has none
    return " ".join(part for part in (name, version, f"({folder})") if part)
