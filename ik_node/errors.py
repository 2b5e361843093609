"""Errors that this package raises on purpose, with one common base class.

Each message names the offending item and, where there is a list of valid choices, lists them.
"""

from __future__ import annotations

from collections.abc import Iterable

EXTRAS = {
    "dask": "archive",
    "distributed": "archive",
    "fsspec": "archive",
    "pyarrow": "archive",
    "lz4": "recording",
    "mcap": "recording",
    "rosbags": "recording",
    "zstandard": "recording",
    "matplotlib": "report",
    "rclpy": "ros",
    "collada": "view",
    "trimesh": "view",
    "viser": "view",
}
"""Package that is imported where it is needed -> extra of ik_node that installs it."""


LONGEST_MESSAGE = 4_000
"""Characters of a message; the frames of a humanoid fit in a list. Messages name what a file contains, which may be
anything."""


class IkNodeError(Exception):
    """Base class of every error that this package raises on purpose. The message is one line of printable text."""

    def __str__(self) -> str:
        """The message, as :func:`one_line`."""
        return one_line(super().__str__())


def one_line(text: str) -> str:
    """A text without control characters; the middle of one beyond :data:`LONGEST_MESSAGE` characters is left out.

    Messages are printed on terminals and published as status: line breaks become blanks, other control characters and
    lone surrogates, which cannot be encoded, their escape sequences.
    """
    if not text.isprintable():
        text = "".join(map(_printable, text))
    half = LONGEST_MESSAGE // 2 - 2  # the reason stands at the end, behind the name
    return text if len(text) <= LONGEST_MESSAGE else f"{text[:half]}...{text[-half:]}"


def _printable(character: str) -> str:
    if character.isprintable():
        return character
    return " " if character.isspace() else character.encode("unicode_escape").decode()


class MissingPackageError(IkNodeError, ImportError):
    """A package that only some functions need is not installed; the message names the extra that installs it."""

    def __init__(self, error: ImportError) -> None:
        """Describe the import that failed."""
        package = (error.name or "").partition(".")[0]
        extra = EXTRAS.get(package)
        if package == "rclpy":
            hint = ": source the setup file of ROS 2, or pip install 'ik_node[ros]'"
        else:
            hint = f": pip install 'ik_node[{extra}]'" if extra else f": {error}"
        super().__init__(f"package {package or '?'} is missing{hint}", name=error.name)


class PackagesError(IkNodeError, ImportError):
    """Numerical packages are missing or do not fit together; the message names them, and what to do."""

    def __init__(self, problem: str) -> None:
        """``problem``: which packages, and why."""
        super().__init__(f"{problem}; install all of requirements.txt in one virtual environment: docs/jazzy.md")


class SettingsError(IkNodeError, ValueError):
    """A parameter has a value outside its type, range or choices, or is not a parameter."""


class RobotError(IkNodeError, ValueError):
    """The robot model cannot be found, read or reduced to the requested joints."""


class UnknownNameError(RobotError):
    """No robot, joint, frame or method has this name; the message lists the names that exist."""

    def __init__(self, kind: str, name: str, valid: Iterable[str], configured: Iterable[str] = ()) -> None:
        """Store ``kind`` ("robot", "joint", ...) and ``name``; list ``valid``, the names that exist.

        ``configured`` are those of them that are listed first.
        """
        first = sorted(configured)
        listed = ", ".join(sorted(set(valid) - set(first))) or "none"
        known = f"{', '.join(first)} (configured); {listed}" if first else listed
        super().__init__(f"unknown {kind} '{name}'; valid: {known}")
        self.kind = kind
        self.name = name


class InputError(IkNodeError, ValueError):
    """A number, vector or matrix has the wrong shape, is not finite, or is not a rotation."""


class TargetRefused(InputError):
    """A target message cannot be followed; the previous target stays in force."""


class StateRefused(InputError):
    """A joint state cannot be used."""


class MethodFault(IkNodeError):
    """An own method raised an exception or returned what is no cost; the arm continues with ``plain``."""


class RecordingError(IkNodeError):
    """A recording cannot be written or read."""


class TrajectoryFileError(IkNodeError, ValueError):
    """A file of poses does not have the format that was described."""


class SceneError(IkNodeError, ValueError):
    """A file or message of obstacles is invalid."""


class CollisionUnavailableError(RobotError):
    """Distances cannot be computed because there is no collision geometry; the message gives the reason."""
