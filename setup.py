"""Build with colcon (ament_python) or pip. requirements.txt pins the versions that were tested together."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "ik_node"
EXECUTABLES = (
    "compile",
    "config",
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
RECORDING = ["mcap", "lz4", "zstandard", "rosbags"]
EXTRAS = {
    "recording": RECORDING,
    "report": ["matplotlib", *RECORDING],
    "archive": [
        "dask==2026.8.0",
        "distributed==2026.8.0",
        "fsspec==2026.9.0",
        "pyarrow==26.0.1",
        "matplotlib",
        *RECORDING,
    ],
    "view": ["viser", "trimesh", "pycollada", *RECORDING],
    "ros": ["ros-jazzy-rclpy", "ros-jazzy-common-interfaces", "ros-jazzy-rmw-fastrtps-cpp", *RECORDING],
}
"""What only some functions need; ``ik_node.errors.EXTRAS`` names these in messages."""


def folder(name: str) -> tuple[str, list[str]]:
    """Return a folder of data files for share/ik_node."""
    return f"share/{NAME}/{name}", sorted(str(path) for path in Path(name).iterdir() if path.is_file())


setup(
    name=NAME,
    version="0.2.0",
    description="Cartesian velocity control of robot arms, recorded to MCAP",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        folder("bringup"),
        folder("config"),
        folder("config/scenes"),
        folder("launch"),
    ],
    python_requires=">=3.10",
    package_data={NAME: ["py.typed"]},
    install_requires=["numpy", "pin", "example-robot-data", "daqp", "numba", "scipy", "PyYAML"],
    extras_require={**EXTRAS, "all": sorted({package for packages in EXTRAS.values() for package in packages})},
    entry_points={
        "console_scripts": [
            f"{'ik_node' if name == 'node' else f'ik_{name}'} = ik_node.cli.{name}:main" for name in EXECUTABLES
        ]
    },
    zip_safe=False,
)
