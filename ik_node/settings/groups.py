"""The parameters of the package, in groups, and :class:`Settings`, which holds one of each group.

The node declares its ROS parameters from these classes, command lines and tests build them, and a recording stores
them. A field of a group with a ``prefix`` is the parameter ``prefix.field``; the fields of :class:`ArmSettings` and
:class:`ControlSettings` have no prefix. Values that belong to the linear and the angular half of a motion are one list
of two elements [linear, angular].
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

from ik_node.settings.follow import FollowSettings
from ik_node.settings.method_names import METHOD_NAMES, OWN_NAMES, check_method_names
from ik_node.settings.names import check_names
from ik_node.settings.recording import RecordingSettings
from ik_node.settings.schema import Descriptor, Group, Value, converted, setting
from ik_node.settings.task import TaskSettings

CONTROL_LAWS = ("twist_feedback", "ik_difference")
"""Values of ``control_law``; implemented in :mod:`ik_node.control.feedback`."""

Pair = tuple[float, float]
"""[linear, angular], or [obstacles, own links]."""


@dataclass(frozen=True)
class ArmSettings(Group):
    """The robot and its controlled joints."""

    robot: str = setting(
        "", "Name of a robot in example-robot-data; ignored if robot_description is given.", read_only=True
    )
    robot_description: str = setting(
        "",
        "URDF, as text or as path of a file; if this and `robot` are empty, the node waits for the topic.",
        read_only=True,
    )
    base_frame: str = setting("", "Frame {s} in which poses are given; default: the root of the model.", read_only=True)
    tip_frame: str = setting(
        "", "Tool frame {b}; default: the usual one, or the end of the longest chain without gripper.", read_only=True
    )
    tool_offset: tuple[float, ...] = setting(
        (), "Pose of the tool point in tip_frame: x y z qx qy qz qw; default: tip_frame itself.", "m", read_only=True
    )
    joints: tuple[str, ...] = setting(
        (),
        "Controlled joints in command order; default: every movable joint between base and tip.",
        read_only=True,
        element=str,
    )
    joint_prefix: str = setting(
        "", "Prefix that joint states have before the joint names of the model.", read_only=True
    )


@dataclass(frozen=True)
class ControlSettings(Group):
    """Control law and resolution of the redundancy."""

    rate_hz: float = setting(
        500.0,
        "Highest rate of control steps; each joint state triggers one, and slower ones are followed.",
        "Hz",
        10.0,
        2000.0,
        read_only=True,
    )
    method: str = setting(
        "plain",
        "Cost that selects the joint velocity among those with the same twist.",
        choices=METHOD_NAMES,
        further=OWN_NAMES,
    )
    extra_methods: tuple[str, ...] = setting(
        (), "Own methods that are loaded at the start, so that `method` can select them.", read_only=True, element=str
    )
    joint_weights: tuple[float, ...] = setting(
        (),
        "Weights of joint_weighted in the order of `joints`: a joint with a larger weight moves less; default: equal.",
        "",
        1e-3,
        1e3,
    )
    locked_joints: tuple[str, ...] = setting(
        (), "Joints that come to rest and stay there; the others follow the task without them.", element=str
    )
    gradient_gain: float = setting(
        0.02, "Gain k of the methods with a gradient; too large a gain is unstable.", "s", 0.0, 1.0
    )
    null_space_speed: float = setting(
        1.0,
        "Maximum joint speed of null-space motion; methods other than obstacle_gradient use 0.3 of it.",
        "rad/s or m/s",
        1e-3,
        10.0,
    )
    control_law: str = setting(
        "twist_feedback",
        "Feedback on the body twist, or on the joint positions found by inverse kinematics.",
        choices=CONTROL_LAWS,
    )
    ik_difference_gain: float = setting(
        20.0,
        "Gain of ik_difference; 1 / period is the law of the lecture notes, stable only without lag.",
        "1/s",
        0.1,
        2000.0,
    )
    arm_lag_s: float = setting(
        0.0, "Time constant with which the arm's velocities follow a command; compensated by prediction.", "s", 0.0, 0.5
    )
    arm_delay_s: float = setting(
        0.0, "Dead time of the arm before a command takes effect; compensated by prediction.", "s", 0.0, 0.5
    )
    gain: tuple[float, float] = setting(
        (10.0, 10.0), "K_p on the pose error [linear, angular].", "1/s, 1/s", 0.0, 200.0, size=2
    )
    integral_gain: tuple[float, float] = setting(
        (0.0, 0.0), "K_i on the pose error [linear, angular]; 0: no integral action.", "1/s2, 1/s2", 0.0, 100.0, size=2
    )
    max_feedback_twist: tuple[float, float] = setting(
        (0.5, 1.5),
        "Maximum speed that feedback alone commands [linear, angular].",
        "m/s, rad/s",
        0.001,
        (10.0, 30.0),
        size=2,
    )
    characteristic_length: float = setting(
        0.3, "Length that converts rotations to comparable translations.", "m", 1e-3, 10.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_method_names(self.method, self.extra_methods)


@dataclass(frozen=True)
class SingularitySettings(Group):
    """Regulation near singularities; singular values are lengths (angular rows times characteristic_length)."""

    prefix: ClassVar[str] = "singularity"
    threshold: float = setting(0.12, "Singular value of J_b below which regulation starts.", "m", 0.01, 1.0)
    tolerance: float = setting(
        0.003, "Path error below which a singularity is passed without slowing down.", "m", 1e-4, 0.1
    )
    timeout_s: float = setting(
        2.5, "Maximum time lost by slowing down before the singular direction is released.", "s", 0.0, 60.0
    )


@dataclass(frozen=True)
class LimitSettings(Group):
    """Joint limits that every command respects."""

    prefix: ClassVar[str] = "limits"
    velocity: tuple[float, ...] = setting(
        (), "Joint velocity limits in the order of `joints`; default: the URDF's.", "rad/s or m/s", 1e-4
    )
    velocity_fraction: float = setting(1.0, "Fraction of the velocity limits that may be used.", "", 0.01, 1.0)
    acceleration: tuple[float, ...] = setting(
        (10.0,), "Joint acceleration limits in the order of `joints`, or one for all.", "rad/s2 or m/s2", 1e-3
    )
    position_lower: tuple[float, ...] = setting(
        (), "Lower position limits in the order of `joints`, or one for all; default: the URDF's.", "rad or m"
    )
    position_upper: tuple[float, ...] = setting(
        (), "Upper position limits in the order of `joints`, or one for all; default: the URDF's.", "rad or m"
    )
    position_margin: float = setting(
        0.0, "Distance kept from position limits, for arms with lag or measurement noise.", "rad or m", 0.0, 1.0
    )
    recovery_speed: float = setting(
        0.1, "Maximum speed at which a joint outside a position limit returns.", "rad/s or m/s", 1e-3, 10.0
    )
    hold_periods: float = setting(
        5.0,
        "Longest time a command may be applied, in control periods; limits hold for any time up to it.",
        "",
        1.0,
        100.0,
    )


@dataclass(frozen=True)
class ObstacleSettings(Group):
    """Obstacles, self-collision and the secondary gradients of redundant arms."""

    prefix: ClassVar[str] = "obstacles"
    scene: str = setting("", "YAML file of obstacles.", read_only=True)
    geometry: str = setting(
        "hull", "Collision shape of each link.", choices=("hull", "capsule", "none"), read_only=True
    )
    package_path: tuple[str, ...] = setting(
        (), "Folders searched for package:// meshes before the ROS installation.", read_only=True, element=str
    )
    srdf: str = setting(
        "",
        "SRDF whose disabled pairs are not checked: its text, the path of a file, or `shipped` for the one that "
        "example-robot-data has for `robot`; default: pairs are selected by sampling.",
        read_only=True,
    )
    self_collision: bool = setting(True, "Check pairs of the arm's own links.", read_only=True)
    ignored_pairs: tuple[str, ...] = setting(
        (), "Pairs link_a:link_b that are never checked.", read_only=True, element=str
    )
    watched_pairs: tuple[str, ...] = setting(
        (), "Pairs link_a:link_b that are always checked.", read_only=True, element=str
    )
    repulsion_range: tuple[float, float] = setting(
        (0.2, 0.05),
        "Distance below which a pair repels in the null space [obstacles, own links].",
        "m, m",
        0.001,
        2.0,
        size=2,
    )
    repulsion_force: float = setting(1000.0, "Repulsive force of a pair in contact.", "N", 0.0, 1e5)
    velocity_damper: bool = setting(
        True, "Limit the speed of approach to obstacles and own links so that the arm can stop."
    )
    stop_distance: tuple[float, float] = setting(
        (0.01, 0.002),
        "Distance at which velocity dampers stop the approach [obstacles, own links].",
        "m, m",
        0.0,
        1.0,
        size=2,
    )
    approach_deceleration: float = setting(
        1.0, "Deceleration that velocity dampers assume; the arm must be capable of more.", "m/s2", 0.01, 100.0
    )
    centring: float = setting(0.0, "Weight of the centres of the joint ranges in the null space.", "J", 0.0, 1e4)
    posture_weight: float = setting(0.0, "Weight of `posture` in the null space.", "N m/rad", 0.0, 1e4)
    posture: tuple[float, ...] = setting((), "Preferred joint positions in the order of `joints`.", "rad or m")


@dataclass(frozen=True)
class TargetSettings(Group):
    """Streams of poses, and the bounds of the reference motion for every kind of target.

    Streams use the whole bounds; jogging, paths and the way to a path use constant fractions of them
    (:mod:`ik_node.targets.bounds`).
    """

    prefix: ClassVar[str] = "target"
    timeout_s: float = setting(
        0.5, "A stream without samples for this long has ended; the arm holds the last pose.", "s", 0.02, 60.0
    )
    max_speed: tuple[float, float] = setting(
        (1.0, 2.5),
        "Maximum speed of the reference motion [linear, angular]; samples further apart are jumps.",
        "m/s, rad/s",
        0.001,
        (10.0, 30.0),
        size=2,
    )
    max_acceleration: tuple[float, float] = setting(
        (10.0, 25.0),
        "Maximum acceleration of the reference motion [linear, angular].",
        "m/s2, rad/s2",
        0.01,
        1000.0,
        size=2,
    )
    max_jerk: tuple[float, float] = setting(
        (500.0, 4000.0), "Maximum jerk of the reference motion [linear, angular].", "m/s3, rad/s3", 1.0, 1e5, size=2
    )


@dataclass(frozen=True)
class PathSettings(Group):
    """Paths and trajectories."""

    prefix: ClassVar[str] = "path"
    speed: tuple[float, float] = setting(
        (0.2, 0.5),
        "Maximum speed along a path without time stamps [linear, angular].",
        "m/s, rad/s",
        0.001,
        (10.0, 30.0),
        size=2,
    )


@dataclass(frozen=True)
class JogSettings(Group):
    """Jogging by twists."""

    prefix: ClassVar[str] = "jog"
    timeout_s: float = setting(0.25, "Without a twist for this long the arm comes to rest.", "s", 0.01, 10.0)


@dataclass(frozen=True)
class StateSettings(Group):
    """Joint states."""

    prefix: ClassVar[str] = "state"
    timeout_s: float = setting(0.1, "Without a joint state for this long the arm is stopped at once.", "s", 0.005, 10.0)
    max_stamp_age_s: float = setting(
        0.1, "If a stamp is older than this, the time of arrival is used instead.", "s", 0.001, 10.0
    )


@dataclass(frozen=True)
class Settings:
    """One of each group; immutable."""

    arm: ArmSettings = ArmSettings()
    control: ControlSettings = ControlSettings()
    task: TaskSettings = TaskSettings()  # noqa: RUF009 - frozen
    singularity: SingularitySettings = SingularitySettings()
    limits: LimitSettings = LimitSettings()
    obstacles: ObstacleSettings = ObstacleSettings()
    target: TargetSettings = TargetSettings()
    path: PathSettings = PathSettings()
    jog: JogSettings = JogSettings()
    state: StateSettings = StateSettings()
    follow: FollowSettings = FollowSettings()  # noqa: RUF009 - frozen
    recording: RecordingSettings = RecordingSettings()  # noqa: RUF009 - frozen

    def flat(self) -> dict[str, Value]:
        """The value of every parameter.

        Returns:
            Full parameter name -> value, in the order of declaration.
        """
        return {name: getattr(group, entry.name) for name, group, entry in _walk(self)}

    def with_values(self, values: Mapping[str, Any]) -> Settings:
        """A copy with changed parameters.

        Args:
            values: Full parameter name -> new value; lists and tuples are both accepted, and whole numbers for
                doubles.

        Returns:
            The changed copy.

        Raises:
            SettingsError: A name is unknown (the message has the nearest one) or belongs to an earlier version (the
                message names its replacement), or a value has the wrong type or is out of range.
        """
        places = _places()
        check_names(values, places)
        changed: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            attribute, field, about = places[name]
            changed.setdefault(attribute, {})[field] = converted(value, about)
        groups = {attribute: dataclasses.replace(getattr(self, attribute), **new) for attribute, new in changed.items()}
        return dataclasses.replace(self, **groups)


@cache
def _places() -> Mapping[str, tuple[str, str, Descriptor]]:
    """Full parameter name -> attribute of :class:`Settings`, attribute of its group, description."""
    attributes = {type(entry.default): entry.name for entry in dataclasses.fields(Settings)}
    default: Any
    places = {}
    for name, group, entry in _walk(Settings()):
        default = entry.default
        places[name] = (
            attributes[type(group)],
            entry.name,
            Descriptor(name=name, default=default, **entry.metadata),
        )
    return places


def _walk(settings: Settings) -> Iterator[tuple[str, Group, dataclasses.Field[Any]]]:
    for group_entry in dataclasses.fields(settings):
        group = getattr(settings, group_entry.name)
        prefix = getattr(group, "prefix", "")
        for entry in dataclasses.fields(group):
            yield (f"{prefix}.{entry.name}" if prefix else entry.name), group, entry


@cache
def describe() -> tuple[Descriptor, ...]:
    """The description of every parameter in the order of declaration.

    Returns:
        One descriptor per parameter; the node, docs/parameters.md and the reports are made from these.
    """
    return tuple(
        Descriptor(name=name, default=getattr(group, entry.name), **entry.metadata)
        for name, group, entry in _walk(Settings())
    )
