"""The result of one control step, as it is published, recorded, reported and displayed.

:class:`Step` is the only declaration of its fields: each is annotated with a :class:`Quantity` (kind, unit, frame,
description). The message codec, the recorded run, the export and the viewer derive their layout from
:data:`STEP_FIELDS`, so a new array, number or list of names needs one line here and the code that computes it.
"""

from __future__ import annotations

from enum import Enum
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np

from ik_node.interfaces.clock import Instant
from ik_node.math.types import Array

FASTER = "faster than target.max_"
"""Part of the status text about a stream that the reference cannot follow; the report finds it by this part."""


OFF_DIRECTION = "the tool leaves the direction of its twist"
"""Begin of the status text about motion off the direction of the twist."""


class Level(Enum):
    """Severity, numbered as in diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Mode(Enum):
    """State of the controller."""

    WAITING = "waiting"
    """No joint state has been received; nothing is commanded."""
    HOLDING = "holding"
    """Closed loop at the last pose."""
    TRACKING = "tracking"
    """Closed loop on a target."""
    RAMPING = "ramping"
    """Decelerating to standstill within the acceleration limits."""
    PAUSED = "paused"
    """At standstill by request."""
    STOPPED = "stopped"
    """Zero velocity was commanded at once; motion resumes when the cause is gone."""
    FAULT = "fault"
    """Zero velocity was commanded at once; the controller stays stopped until it is reset."""


CLOSED_LOOP = (Mode.HOLDING, Mode.TRACKING)
"""Modes in which the control law computes the commands."""


class Status(NamedTuple):
    """State of the controller with its reason."""

    level: Level
    mode: Mode
    reason: str

    def with_warning(self, text: str) -> Status:
        """This status with ``text`` added, at level WARN at least; unchanged for an empty text."""
        if not text:
            return self
        level = self.level if self.level is Level.ERROR else Level.WARN
        return Status(level, self.mode, f"{self.reason}; {text}")


class Kind(Enum):
    """Type and shape of a field of :class:`Step`; n is the number of controlled joints."""

    COUNTER = "counter"
    """An integer."""
    INSTANT = "instant"
    """A time on both clocks."""
    TIME = "time"
    """Monotonic time in ns, an integer."""
    NUMBER = "number"
    """One float."""
    JOINTS = "joints"
    """One number per joint, (n,)."""
    POSE = "pose"
    """Homogeneous transformation, (4, 4)."""
    TWIST = "twist"
    """Linear, then angular components, (6,): twist, pose error or multiplier."""
    SINGULAR_VALUES = "singular values"
    """(min(6, n),)."""
    POINT_PAIR = "point pair"
    """Two points, (2, 3)."""
    NAMES = "names"
    """A tuple of texts."""
    STATUS = "status"
    """A :class:`Status`."""


class Quantity(NamedTuple):
    """Annotation of a field of :class:`Step`."""

    kind: Kind
    description: str
    unit: str = ""
    """Of linear and angular components in this order, where they differ; units of prismatic joints in parentheses."""
    frame: str = ""
    """In which the components are expressed: ``s`` (base) or ``b`` (tool); empty for none."""


class Step(NamedTuple):
    """All results of one control step. What a stopped controller does not compute is NaN."""

    tick: Annotated[int, Quantity(Kind.COUNTER, "Number of the control step, counted from 0 at configuration.")]
    now: Annotated[Instant, Quantity(Kind.INSTANT, "Time of the control step.")]
    state_time_ns: Annotated[int, Quantity(Kind.TIME, "Monotonic time at which joint_position was measured.", "ns")]
    joint_position: Annotated[Array, Quantity(Kind.JOINTS, "Measured q.", "rad (m)")]
    joint_velocity: Annotated[
        Array, Quantity(Kind.JOINTS, "Commanded qd; always finite and within the velocity limits.", "rad/s (m/s)")
    ]
    pose_sb: Annotated[Array, Quantity(Kind.POSE, "Tool pose T_sb at joint_position.", "m", "s")]
    pose_sd: Annotated[Array, Quantity(Kind.POSE, "Desired pose T_sd at state_time_ns.", "m", "s")]
    error_b: Annotated[
        Array,
        Quantity(Kind.TWIST, "Pose error log(T_bd); with `task.tolerance` what exceeds the tolerance.", "m, rad", "b"),
    ]
    feedforward_b: Annotated[
        Array,
        Quantity(
            Kind.TWIST, "Feed-forward twist Ad(T_bd) V_d; with `task.tolerance` its followed part.", "m/s, rad/s", "b"
        ),
    ]
    twist_b: Annotated[
        Array,
        Quantity(
            Kind.TWIST,
            "Task twist V: feed-forward plus feedback; with `ik_difference` J times the joint velocity of the law.",
            "m/s, rad/s",
            "b",
        ),
    ]
    truncated_b: Annotated[
        Array,
        Quantity(
            Kind.TWIST,
            "V - V_f: part of V given up near a singularity, or deferred because the joints cannot follow its change.",
            "m/s, rad/s",
            "b",
        ),
    ]
    off_direction_b: Annotated[
        Array,
        Quantity(
            Kind.TWIST,
            "J qd - s V_f: motion of the tool off the direction of V_f, because of `off_direction_limits`.",
            "m/s, rad/s",
            "b",
        ),
    ]
    scale: Annotated[
        float, Quantity(Kind.NUMBER, "Task scale s in [0, 1]: fraction of V_f that the limits admit; NaN when stopped.")
    ]
    multiplier_task: Annotated[
        Array,
        Quantity(
            Kind.TWIST,
            "First term of the multiplier lambda: a task-space momentum for mass-weighted methods, not a force.",
            "N s, N m s",
            "b",
        ),
    ]
    multiplier_potential: Annotated[
        Array,
        Quantity(
            Kind.TWIST,
            "Second term of lambda; divided by the potential's gain k it is a wrench on the tool.",
            "k N, k N m",
            "b",
        ),
    ]
    singular_values: Annotated[
        Array,
        Quantity(
            Kind.SINGULAR_VALUES,
            "Singular values of the followed rows of J_b, angular ones times the characteristic length, descending; "
            "NaN for the missing ones of a task with a tolerance or of locked joints.",
            "m",
        ),
    ]
    binding: Annotated[tuple[str, ...], Quantity(Kind.NAMES, "Active limits, for example `velocity panda_joint4`.")]
    off_direction_limits: Annotated[
        tuple[str, ...],
        Quantity(Kind.NAMES, "Active limits that cause `off_direction_b`, the most effective first; usually empty."),
    ]
    progress: Annotated[float, Quantity(Kind.NUMBER, "Completed fraction of the path, 0 to 1; NaN without a path.")]
    path_distance: Annotated[
        float, Quantity(Kind.NUMBER, "Distance of the tool point from the path; NaN without a path.", "m")
    ]
    clearance: Annotated[
        float, Quantity(Kind.NUMBER, "Distance of the closest pair of links, or of link and obstacle.", "m")
    ]
    closest_points: Annotated[Array, Quantity(Kind.POINT_PAIR, "Nearest points of that pair.", "m", "s")]
    closest_pair: Annotated[tuple[str, ...], Quantity(Kind.NAMES, "Names of that pair; empty when not computed.")]
    status: Annotated[Status, Quantity(Kind.STATUS, "Mode and reason.")]


class StepField(NamedTuple):
    """One field of :class:`Step`."""

    name: str
    quantity: Quantity

    @property
    def kind(self) -> Kind:
        """Type and shape."""
        return self.quantity.kind

    def shape(self, n: int) -> tuple[int, ...]:
        """Shape of an array or number for ``n`` joints; a number is ()."""
        return _SHAPES[self.kind] if self.kind in _SHAPES else (n if self.kind is Kind.JOINTS else min(6, n),)

    def not_computed(self, n: int) -> Any:
        """Value where nothing was computed: NaN in every component, or no names."""
        if self.kind is Kind.NAMES:
            return ()
        return float("nan") if self.kind is Kind.NUMBER else np.full(self.shape(n), np.nan)


_SHAPES: dict[Kind, tuple[int, ...]] = {Kind.NUMBER: (), Kind.POSE: (4, 4), Kind.TWIST: (6,), Kind.POINT_PAIR: (2, 3)}
_ARRAY_KINDS = (Kind.JOINTS, Kind.POSE, Kind.TWIST, Kind.SINGULAR_VALUES, Kind.POINT_PAIR)


def _step_fields() -> dict[str, StepField]:
    hints = get_type_hints(Step, include_extras=True)
    return {name: StepField(name, hints[name].__metadata__[0]) for name in Step._fields}


STEP_FIELDS = _step_fields()
"""Name of a field of Step -> its declaration, in the order of Step."""
ARRAY_FIELDS = tuple(field for field in STEP_FIELDS.values() if field.kind in _ARRAY_KINDS)
"""Fields that are arrays of float64."""
NUMBER_FIELDS = tuple(field for field in STEP_FIELDS.values() if field.kind is Kind.NUMBER)
"""Fields that are single floats."""
TEXT_FIELDS = tuple(field for field in STEP_FIELDS.values() if field.kind in (Kind.NAMES, Kind.STATUS))
"""Fields that are text."""


def smallest_singular_value(values: Array) -> Array:
    """The smallest of ``singular_values``, of one Step () or of k (k,), m; NaN where there is none."""
    return np.asarray(np.fmin.reduce(values, axis=-1, initial=np.nan))


def bare_step(
    tick: int, now: Instant, state_time_ns: int, position: Array, pose_sb: Array, velocity: Array, status: Status
) -> Step:
    """A Step without a control law: a ramp or a stop. All other fields are NaN or empty.

    Args:
        tick: Number of the control step.
        now: Time of the control step.
        state_time_ns: Monotonic time of ``position``.
        position: Measured q, (n,), rad (m); NaN when unknown.
        pose_sb: Tool pose at q, (4, 4).
        velocity: Commanded qd, (n,), rad/s (m/s).
        status: Mode and reason.
    """
    given = {
        "tick": tick,
        "now": now,
        "state_time_ns": state_time_ns,
        "joint_position": position,
        "joint_velocity": velocity,
        "pose_sb": pose_sb,
        "status": status,
    }
    n = len(velocity)
    values: dict[str, Any] = {
        name: given[name] if name in given else field.not_computed(n) for name, field in STEP_FIELDS.items()
    }
    return Step(**values)
