"""The package's own errors: one root, so that a caller can catch everything of ours at once.

Each message names the offending thing and, where there is a list of valid choices, lists them.
"""

from __future__ import annotations

from collections.abc import Iterable


class IkNodeError(Exception):
    """Root of every error that this package raises on purpose."""


class SettingsError(IkNodeError, ValueError):
    """A parameter has a value outside its stated type, range or choices."""


class RobotError(IkNodeError, ValueError):
    """The robot model cannot be found, read or reduced to what was asked."""


class UnknownNameError(RobotError):
    """A robot, joint, frame or method of that name does not exist; the message lists those that do."""

    def __init__(self, kind: str, name: str, valid: Iterable[str]) -> None:
        listed = ", ".join(sorted(valid)) or "none"
        super().__init__(f"unknown {kind} '{name}'; valid: {listed}")
        self.kind = kind
        self.name = name


class InputError(IkNodeError, ValueError):
    """A number, vector or matrix that was passed in is of the wrong shape, not finite, or no rotation."""


class TargetRefused(InputError):
    """A target message cannot be followed; the arm goes on with what it had."""


class StateRefused(InputError):
    """A joint state cannot be used."""


class RecordingError(IkNodeError):
    """A recording cannot be written or read."""


class TrajectoryFileError(IkNodeError, ValueError):
    """A file of poses cannot be understood as the caller described it."""


class SceneError(IkNodeError, ValueError):
    """A file of obstacles cannot be understood."""


class CollisionUnavailableError(RobotError):
    """There is no collision geometry to measure distances with; the message says why. The rest works without."""
