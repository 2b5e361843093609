"""Build with colcon (ament_python) or pip; which versions were tried together stands in requirements.txt."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "ik_node"
EXECUTABLES = (
    "demo",
    "export",
    "node",
    "repair",
    "replay",
    "report",
    "simulator",
    "solve",
    "view",
    "watchdog",
)


def folder(name: str) -> tuple[str, list[str]]:
    """A folder of data files, installed under share/ik_node."""
    return f"share/{NAME}/{name}", sorted(str(path) for path in Path(name).iterdir() if path.is_file())


setup(
    name=NAME,
    version="0.1.0",
    description="Cartesian velocity control of robot arms, recorded to MCAP",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        folder("config"),
        folder("config/scenes"),
        folder("launch"),
    ],
    python_requires=">=3.10",
    install_requires=[
        "numpy",
        "pin",
        "example-robot-data",
        "daqp",
        "numba",
        "scipy",
        "mcap",
        "lz4",
        "zstandard",
        "rosbags",
        "matplotlib",
        "PyYAML",
    ],
    extras_require={
        "ros": ["ros-jazzy-rclpy", "ros-jazzy-common-interfaces", "ros-jazzy-rmw-fastrtps-cpp"],
        "view": ["viser", "trimesh", "pycollada"],
    },
    entry_points={
        "console_scripts": [
            f"{'ik_node' if name == 'node' else f'ik_{name}'} = ik_node.cli.{name}:main" for name in EXECUTABLES
        ]
    },
    zip_safe=True,
)
