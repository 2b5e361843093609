"""A path over time: its geometry, and the law by which it is gone through where its own parameter is not time."""

from __future__ import annotations

from ik_node.trajectory.offset import slowed
from ik_node.trajectory.reference import RigidMotion
from ik_node.trajectory.rigid_spline import Knots, RigidSpline
from ik_node.trajectory.rotations import Quaternion, Vector
from ik_node.trajectory.time_law import LawTable, TimeLaw


class TimedPath:
    """Immutable."""

    def __init__(self, knots: Knots, law: LawTable | None) -> None:
        """``law``: None where the knots' parameter is time in seconds."""
        self.spline = RigidSpline(knots)
        self._law = None if law is None else TimeLaw(law)

    @property
    def end_s(self) -> float:
        """When it ends; it begins at 0."""
        return self.spline.end_s if self._law is None else self._law.duration_s

    def pose(self, time_s: float) -> tuple[Vector, Quaternion]:
        """Position [m] and orientation (w, x, y, z); held at its ends."""
        return self.spline.pose(time_s if self._law is None else self._law.place(time_s))

    def motion(self, time_s: float) -> RigidMotion:
        """Pose, velocity and acceleration."""
        if self._law is None:
            return self.spline.motion(time_s)
        return slowed(self.spline.motion(self._law.place(time_s)), *self._law.rates(time_s))

    def distance_m(self, position: Vector, time_s: float) -> float:
        """How near the path comes to ``position``, looked for downhill from where it is at ``time_s``."""
        return self.spline.nearest(position, time_s if self._law is None else self._law.place(time_s))[1]

    def resting(self, time_s: float) -> RigidMotion:
        """At rest at one pose of the path."""
        position, orientation = self.pose(time_s)
        return RigidMotion(position, orientation=orientation)
