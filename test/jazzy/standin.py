"""A stand-in for Ubuntu 24.04 with ROS 2 Jazzy, in a folder.

It has Python 3.12 with NumPy 1.26.4, SciPy 1.11.4 and colcon, a pip that refuses to install outside a virtual
environment (PEP 668), and ROS 2 from PyPI's wheels, found by PYTHONPATH like that of /opt/ros.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from support import PROJECT

SYSTEM_PACKAGES = (
    "numpy==1.26.4",
    "scipy==1.11.4",
    "PyYAML==6.0.1",
    "setuptools==68.1.2",
    "colcon-core",
    "colcon-ros",
    "colcon-bash",
    "colcon-python-setup-py",
    "colcon-recursive-crawl",
    "colcon-library-path",
    "colcon-package-selection",
    "colcon-output",
    "colcon-metadata",
    "colcon-package-information",
    "colcon-parallel-executor",
)
ROS_PREFIXES = ("ros-", "lark-parser", "empy", "packaging", "typing_extensions")
"""Requirements that a ROS installation brings along."""
PIP = """#!{python}
import sys
from pip._internal.cli.main import main
sys.exit(main())
"""
SETUP = """
export AMENT_PREFIX_PATH={ros}
export PYTHONPATH={site}${{PYTHONPATH:+:$PYTHONPATH}}
export LD_LIBRARY_PATH={ros}/lib:$(ls -d {site}/*.libs | tr '\\n' ':')
"""


def python312() -> Path | None:
    """A Python 3.12 that can be copied: on PATH, or beside the one that runs this."""
    beside = Path(sys.base_prefix).parent.glob("3.12*/bin/python3.12")
    on_path = [Path(found)] if (found := shutil.which("python3.12")) else []
    question = "import sys, ensurepip, venv; print(*sys.version_info[:2], sys.base_prefix)"
    for python in (*beside, *on_path):
        asked = subprocess.run([python, "-c", question], capture_output=True, text=True, check=False)
        answer = asked.stdout.split()
        if answer[:2] == ["3", "12"] and Path(answer[2]).parts[1:2] != ("usr",):  # not the prefix of a whole system
            return Path(answer[2]) / "bin" / "python3.12"
    return None


def clean_environment(system: Path, home: Path) -> dict[str, str]:
    """The environment of a new terminal."""
    kept = ("LANG", "TMPDIR", "SSL_CERT_FILE", "PIP_INDEX_URL", "PIP_CERT", "ROS_DOMAIN_ID", "OPENBLAS_CORETYPE")
    return {
        **{name: os.environ[name] for name in kept if name in os.environ},
        "PATH": f"{system}/bin:/usr/bin:/bin",
        "HOME": str(home),
        "PIP_NO_COMPILE": "1",
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }


def build(folder: Path, python: Path) -> tuple[Path, Path]:
    """Build the stand-in.

    Args:
        folder: An empty folder.
        python: A Python 3.12, which is copied.

    Returns:
        Prefix of the system; prefix of ROS, in place of /opt/ros/jazzy.
    """
    system, ros = folder / "usr", folder / "ros"
    shutil.copytree(python.parents[1], system, symlinks=True, ignore=shutil.ignore_patterns("test", "__pycache__"))
    own = system / "bin" / "python3.12"
    environment = clean_environment(system, folder)

    def run(*command: str | Path) -> None:
        subprocess.run([*map(str, command)], env=environment, check=True, stdout=subprocess.DEVNULL)

    for name in ("pip", "pip3"):
        (system / "bin" / name).write_text(PIP.format(python=own))
    run(own, "-m", "pip", "install", "-q", *SYSTEM_PACKAGES)
    run(own, "-m", "venv", ros)
    lines = (PROJECT / "requirements.txt").read_text().splitlines()
    (folder / "ros.txt").write_text("\n".join(line for line in lines if line.startswith(ROS_PREFIXES)))
    run(ros / "bin" / "python", "-m", "pip", "install", "-q", "--no-deps", "-r", folder / "ros.txt")
    site = ros / "lib" / "python3.12" / "site-packages"
    (ros / "setup.bash").write_text(SETUP.format(ros=ros, site=site))
    (system / "lib" / "python3.12" / "EXTERNALLY-MANAGED").write_text("[externally-managed]\nError=refused\n")
    return system, ros
