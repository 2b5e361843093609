"""Every setting there is: default, unit, range and description, said once.

The node declares its parameters from these classes, command lines and tests build them, a recording stores them. A
group's field becomes the parameter ``group.field``; the fields of ``Settings.arm`` and ``Settings.control`` have no
prefix.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

from ik_node.errors import SettingsError

Value = bool | int | float | str | tuple[str, ...] | tuple[float, ...]

METHODS = ("plain", "inertia_weighted", "obstacle_gradient", "gravity_gradient")
"""Names of the pseudoinverses that ``method`` can select; :mod:`ik_node.differential_ik.methods` has them."""
CONTROL_LAWS = ("twist_feedback", "ik_difference")
"""Names of the laws that ``control_law`` can select; :mod:`ik_node.control.feedback` has them."""


def setting(
    default: Value,
    description: str,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
    read_only: bool = False,
    element: type = float,
) -> Any:
    """A dataclass field that carries what a person needs to know about the parameter; ``element`` is a list's type."""
    about = {
        "description": description,
        "unit": unit,
        "minimum": minimum,
        "maximum": maximum,
        "choices": choices,
        "read_only": read_only,
        "element": element,
    }
    return field(default=default, metadata=about)


class Descriptor(NamedTuple):
    """What :func:`describe` says of one parameter."""

    name: str
    default: Value
    description: str
    unit: str
    minimum: float | None
    maximum: float | None
    choices: tuple[str, ...]
    read_only: bool
    element: type
    """Of a list's entries."""


@dataclass(frozen=True)
class Group:
    """Checks its own fields, so that no group with a value out of range can exist."""

    def __post_init__(self) -> None:
        for entry in dataclasses.fields(self):
            about = entry.metadata
            if about:
                _check(entry.name, getattr(self, entry.name), entry.default, about)


def _check(name: str, value: Any, default: Any, about: Mapping[str, Any]) -> None:
    wanted = type(default)
    if wanted is tuple:
        kinds = (about["element"], int) if about["element"] is float else (about["element"],)
        if not isinstance(value, tuple) or any(type(entry) not in kinds for entry in value):
            raise SettingsError(f"{name} is {value!r}; expected a list of {about['element'].__name__}")
    elif wanted is float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise SettingsError(f"{name} is {value!r}; expected a number")
    elif not isinstance(value, wanted) or (wanted is not bool and isinstance(value, bool)):
        raise SettingsError(f"{name} is {value!r}; expected a {wanted.__name__}")
    if about["choices"] and value not in about["choices"]:
        raise SettingsError(f"{name} is {value!r}; valid: {', '.join(about['choices'])}")
    low, high = about["minimum"], about["maximum"]
    for number in value if isinstance(value, tuple) else (value,):
        if isinstance(number, (str, bool)):
            continue
        if not math.isfinite(number):
            raise SettingsError(f"{name} is {value!r}; expected finite numbers")
        if (low is not None and number < low) or (high is not None and number > high):
            raise SettingsError(f"{name} is {value!r}; valid: {_range(low, high)} {about['unit']}".rstrip())


def _range(low: float | None, high: float | None) -> str:
    return f"{'-inf' if low is None else f'{low:g}'} to {'inf' if high is None else f'{high:g}'}"


@dataclass(frozen=True)
class ArmSettings(Group):
    """Which robot, and which part of it is controlled."""

    robot: str = setting(
        "", "Name of a robot in example-robot-data; ignored when robot_description is given.", read_only=True
    )
    robot_description: str = setting(
        "", "URDF as text; when this and `robot` are empty, the topic robot_description is waited for.", read_only=True
    )
    base_frame: str = setting("", "Frame {s} of poses; default: the root of the model.", read_only=True)
    tip_frame: str = setting(
        "", "Tool frame {b}; default: the robot's usual tool, else the end of the longest chain.", read_only=True
    )
    tool_offset: tuple[float, ...] = setting(
        (), "Tool point seen from tip_frame: x y z qx qy qz qw; default: tip_frame itself.", "m", read_only=True
    )
    joints: tuple[str, ...] = setting(
        (),
        "Controlled joints in command order; default: every movable one between base and tip.",
        read_only=True,
        element=str,
    )
    joint_prefix: str = setting(
        "", "Put before every joint name of the model when matching joint states.", read_only=True
    )


@dataclass(frozen=True)
class ControlSettings(Group):
    """The control law."""

    rate_hz: float = setting(
        500.0, "Highest tick rate; each tick is made by a joint state.", "Hz", 10.0, 2000.0, read_only=True
    )
    min_rate_fraction: float = setting(0.3, "Joint states slower than this part of rate_hz are a fault.", "", 0.0, 1.0)
    method: str = setting("plain", "How joint velocities are chosen among those that give the twist.", choices=METHODS)
    gradient_gain: float = setting(
        0.02, "k of the methods with a gradient; more moves the null space faster, and at last unstably.", "s", 0.0, 1.0
    )
    null_space_speed: float = setting(
        0.3,
        "No joint moves faster than this for the gradient's sake; `obstacle_gradient`: obstacles.evasion_speed.",
        "rad/s or m/s",
        1e-3,
        10.0,
    )
    jacobian: str = setting("body", "Frame in which the problem is written.", choices=("body", "space"))
    control_law: str = setting(
        "twist_feedback",
        "Feedback on the body twist, or on the joints that inverse kinematics gives.",
        choices=CONTROL_LAWS,
    )
    ik_difference_gain: float = setting(
        20.0,
        "Gain of ik_difference; 1 over the period is the notes' law and needs an arm without lag.",
        "1/s",
        0.1,
        2000.0,
    )
    arm_lag_s: float = setting(
        0.0,
        "Lag with which the arm's velocities answer a command; the control law looks that far ahead.",
        "s",
        0.0,
        0.5,
    )
    arm_delay_s: float = setting(0.0, "Time until the arm knows a command, beside its lag.", "s", 0.0, 0.5)
    gain_linear: float = setting(10.0, "K_p on the position error.", "1/s", 0.0, 200.0)
    gain_angular: float = setting(10.0, "K_p on the orientation error.", "1/s", 0.0, 200.0)
    gain_integral_linear: float = setting(0.0, "K_i on the position error; 0: none.", "1/s2", 0.0, 100.0)
    gain_integral_angular: float = setting(0.0, "K_i on the orientation error; 0: none.", "1/s2", 0.0, 100.0)
    max_integral_linear: float = setting(
        0.05, "Cap on the speed that integral action asks of the tool point.", "m/s", 1e-4, 1.0
    )
    max_integral_angular: float = setting(
        0.2, "Cap on the turning rate that integral action asks of the tool.", "rad/s", 1e-4, 3.0
    )
    max_feedback_linear: float = setting(
        0.5, "Cap on the speed that feedback alone asks of the tool point.", "m/s", 0.001, 10.0
    )
    max_feedback_angular: float = setting(
        1.5, "Cap on the turning rate that feedback alone asks of the tool.", "rad/s", 0.001, 30.0
    )
    singularity_threshold: float = setting(
        0.02,
        "Singular value of J_b (angular rows times characteristic_length) below which its direction fades.",
        "m",
        1e-6,
        1.0,
    )
    characteristic_length: float = setting(
        0.3, "Length that makes rotations comparable with translations.", "m", 1e-3, 10.0
    )


@dataclass(frozen=True)
class SingularitySettings(Group):
    """How singularities are passed; lengths compare with singular values, rotations times characteristic_length."""

    prefix: ClassVar[str] = "singularity"
    threshold: float = setting(0.12, "Singular value of J_b below which its direction is looked after.", "m", 0.01, 1.0)
    tolerance: float = setting(
        0.003,
        "Error that is cheaper than half a turn of the wrist: passing closer than this, V is not slowed down.",
        "m",
        1e-4,
        0.1,
    )
    patience_s: float = setting(
        2.5, "Time that slowing down may cost before the lost direction is let go.", "s", 0.0, 60.0
    )


@dataclass(frozen=True)
class LimitSettings(Group):
    """What no command exceeds."""

    prefix: ClassVar[str] = "limits"
    velocity: tuple[float, ...] = setting(
        (), "Joint velocity limits in the order of `joints`; default: the URDF's.", "rad/s or m/s", 1e-4
    )
    velocity_fraction: float = setting(1.0, "Part of the velocity limits that may be used.", "", 0.01, 1.0)
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
        0.0, "Distance kept from position limits, for arms that lag or measure with noise.", "rad or m", 0.0, 1.0
    )
    recovery_speed: float = setting(
        0.1, "Speed at which a joint outside a position limit is brought back.", "rad/s or m/s", 1e-3, 10.0
    )
    hold_periods: float = setting(
        5.0, "Longest time a command may stand, in control periods; limits hold for any time up to it.", "", 1.0, 100.0
    )


@dataclass(frozen=True)
class ObstacleSettings(Group):
    """Obstacles, self-collision and the secondary gradients of redundant arms."""

    prefix: ClassVar[str] = "obstacles"
    scene: str = setting("", "YAML file of obstacles.", read_only=True)
    geometry: str = setting(
        "hull", "What each link of the arm becomes.", choices=("hull", "capsule", "none"), read_only=True
    )
    package_path: tuple[str, ...] = setting(
        (), "Folders in which package:// meshes are looked for before the ROS installation's.", read_only=True
    )
    srdf: str = setting(
        "",
        "SRDF whose disabled pairs are not watched: its text, the path of a file, or `shipped` for the one that "
        "example-robot-data has for `robot`; default: pairs are chosen by sampling.",
        read_only=True,
    )
    self_collision: bool = setting(True, "Watch pairs of the arm's own links.", read_only=True)
    ignored_pairs: tuple[str, ...] = setting((), "Pairs link_a:link_b that are not watched.", read_only=True)
    watched_pairs: tuple[str, ...] = setting((), "Pairs link_a:link_b that are watched all the same.", read_only=True)
    range: float = setting(0.2, "Obstacles nearer than this push the null space.", "m", 0.001, 2.0)
    self_range: float = setting(0.05, "Links of the arm nearer than this push the null space.", "m", 0.001, 2.0)
    strength: float = setting(1000.0, "Push of a pair in contact.", "N", 0.0, 1e5)
    look_ahead_s: float = setting(
        0.5, "The null space is pushed away also from what the arm is going to meet in this time.", "s", 0.0, 5.0
    )
    evasion_speed: float = setting(
        1.0, "No joint moves faster than this in the null space to keep clear of obstacles.", "rad/s or m/s", 1e-3, 10.0
    )
    damper: bool = setting(True, "Keep the speed of approach to obstacles and to itself low enough to stop.")
    damper_range: float = setting(0.5, "Dampers look no further than this.", "m", 0.001, 5.0)
    stop_distance: float = setting(0.01, "Distance from obstacles at which approach ends.", "m", 0.0, 1.0)
    self_stop_distance: float = setting(0.002, "Distance of own links at which approach ends.", "m", 0.0, 1.0)
    approach_deceleration: float = setting(
        1.0, "Deceleration that dampers count on; the arm must be able to do more.", "m/s2", 0.01, 100.0
    )
    centring: float = setting(0.0, "Weight of the middle of the joint ranges in the null space.", "J", 0.0, 1e4)
    posture_weight: float = setting(0.0, "Weight of `posture` in the null space.", "N m/rad", 0.0, 1e4)
    posture: tuple[float, ...] = setting((), "Wanted joint positions in the order of `joints`.", "rad or m")


@dataclass(frozen=True)
class TargetSettings(Group):
    """How a stream of poses becomes a motion."""

    prefix: ClassVar[str] = "target"
    timeout_s: float = setting(
        0.5, "A stream silent for this long has ended; the arm holds the last pose.", "s", 0.02, 60.0
    )
    max_age_s: float = setting(
        1.0, "Stamps older than this are taken for another clock; arrival counts instead.", "s", 0.01, 60.0
    )
    max_linear_speed: float = setting(1.0, "Fastest motion of the reference.", "m/s", 0.001, 10.0)
    max_angular_speed: float = setting(
        2.5, "Fastest turn of the reference; implied rates above are jumps.", "rad/s", 0.001, 30.0
    )
    max_linear_acceleration: float = setting(10.0, "Highest acceleration of the reference.", "m/s2", 0.01, 1000.0)
    max_angular_acceleration: float = setting(
        25.0, "Highest angular acceleration of the reference.", "rad/s2", 0.01, 1000.0
    )
    catch_up_linear_speed: float = setting(
        0.5, "Fastest correction of the reference's position: how jumps are approached.", "m/s", 0.001, 10.0
    )
    catch_up_angular_speed: float = setting(
        2.5, "Fastest correction of the reference's orientation: how jumps are approached.", "rad/s", 0.001, 30.0
    )
    max_linear_jerk: float = setting(500.0, "Highest jerk of the reference.", "m/s3", 1.0, 1e5)
    max_angular_jerk: float = setting(1000.0, "Highest angular jerk of the reference.", "rad/s3", 1.0, 1e5)
    latency_linear: float = setting(
        0.9, "Most that the position may lag to be smoother, in sample periods; none if predictable.", "", 0.0, 2.0
    )
    latency_angular: float = setting(
        1.0, "Most that the orientation may lag to be smoother, in sample periods; none if predictable.", "", 0.0, 2.0
    )
    bandwidth: float = setting(
        3.5, "Bandwidth of the reference times the sample period; less is smoother, more is nearer.", "rad", 0.1, 10.0
    )
    max_bandwidth: float = setting(65.0, "Highest bandwidth of the reference, for fast streams.", "rad/s", 1.0, 80.0)


@dataclass(frozen=True)
class PathSettings(Group):
    """Paths and trajectories that come as a whole, and how the arm gets onto them."""

    prefix: ClassVar[str] = "path"
    approach_linear_speed: float = setting(0.2, "Speed at which a path is approached.", "m/s", 0.001, 10.0)
    approach_angular_speed: float = setting(0.8, "Turning rate at which a path is approached.", "rad/s", 0.001, 30.0)
    approach_linear_acceleration: float = setting(
        2.0, "Acceleration of the approach to a path, and of coming to rest.", "m/s2", 0.01, 100.0
    )
    approach_angular_acceleration: float = setting(
        8.0, "Angular acceleration of the approach to a path, and of coming to rest.", "rad/s2", 0.01, 100.0
    )
    approach_linear_jerk: float = setting(40.0, "Jerk of the approach to a path.", "m/s3", 0.1, 1e4)
    approach_angular_jerk: float = setting(160.0, "Angular jerk of the approach to a path.", "rad/s3", 0.1, 1e4)
    join_distance: float = setting(
        0.02,
        "A path that has begun is joined where it is now if that is no further away; else at its start.",
        "m",
        0.0,
        1.0,
    )
    join_angle: float = setting(0.1, "The same for the orientation.", "rad", 0.0, 1.0)
    linear_speed: float = setting(0.2, "Speed along a path without times.", "m/s", 0.001, 10.0)
    angular_speed: float = setting(0.5, "Turning rate along a path without times.", "rad/s", 0.001, 30.0)
    linear_acceleration: float = setting(0.5, "Acceleration along a path without times.", "m/s2", 0.01, 100.0)
    angular_acceleration: float = setting(
        2.0, "Angular acceleration along a path without times.", "rad/s2", 0.01, 100.0
    )
    max_ahead_s: float = setting(60.0, "A path that begins later than this from now is refused.", "s", 0.0, 1e5)
    max_poses: int = setting(2000, "Longer paths are refused: taking 1000 poses costs 10 ms.", "", 2, 100_000)


@dataclass(frozen=True)
class JogSettings(Group):
    """Jogging by twists."""

    prefix: ClassVar[str] = "jog"
    timeout_s: float = setting(0.25, "Without a twist for this long the arm comes to rest.", "s", 0.01, 10.0)
    max_linear_speed: float = setting(0.25, "Faster twists are cut to this.", "m/s", 0.001, 10.0)
    max_angular_speed: float = setting(1.0, "Faster turns are cut to this.", "rad/s", 0.001, 30.0)
    linear_acceleration: float = setting(2.0, "Highest acceleration.", "m/s2", 0.01, 100.0)
    angular_acceleration: float = setting(8.0, "Highest angular acceleration.", "rad/s2", 0.01, 100.0)
    linear_jerk: float = setting(40.0, "Highest jerk.", "m/s3", 0.1, 1e4)
    angular_jerk: float = setting(160.0, "Highest angular jerk.", "rad/s3", 0.1, 1e4)
    leash_distance: float = setting(
        0.03, "The reference runs no further ahead of a tool that cannot follow.", "m", 0.001, 1.0
    )
    leash_angle: float = setting(0.15, "The same for the orientation.", "rad", 0.001, 1.0)


@dataclass(frozen=True)
class StateSettings(Group):
    """Joint states and their supervision."""

    prefix: ClassVar[str] = "state"
    timeout_s: float = setting(0.1, "Without a joint state for this long the arm is stopped at once.", "s", 0.005, 10.0)
    max_age_s: float = setting(
        0.1, "Stamps older than this are taken for another clock; arrival counts instead.", "s", 0.001, 10.0
    )


@dataclass(frozen=True)
class FollowSettings(Group):
    """Whether the robot does what it is told."""

    prefix: ClassVar[str] = "follow"
    enabled: bool = setting(True, "Notice a robot that does not follow its commands.")
    part: float = setting(
        0.5, "A robot that does less than this part of what it is told does not follow.", "", 0.0, 1.0
    )
    least_motion: float = setting(
        0.03, "Nothing is judged before a joint was told to go this far.", "rad or m", 1e-4, 1.0
    )
    window_s: float = setting(
        0.25, "Time over which fast motions are judged; slow ones over 8 of them.", "s", 0.05, 5.0
    )
    retry_s: float = setting(1.0, "A robot that did not follow is tried again after this time.", "s", 0.1, 60.0)


@dataclass(frozen=True)
class RecordingSettings(Group):
    """Recording of runs."""

    prefix: ClassVar[str] = "recording"
    enabled: bool = setting(False, "Record from configuration on.", read_only=True)
    directory: str = setting(
        "", "Folder of the recording; must not exist; default: ik_node_ and the time, here.", read_only=True
    )
    compression: str = setting(
        "zstd", "How chunks of a recording are compressed.", choices=("none", "lz4", "zstd"), read_only=True
    )
    flush_period_s: float = setting(
        0.1, "How often messages go to the file: what a killed process loses.", "s", 0.01, 0.2, read_only=True
    )
    queue_mb: float = setting(
        32.0, "Memory for messages that wait for the disk; further ones are dropped.", "MB", 0.1, 4096.0, read_only=True
    )
    max_part_mb: float = setting(0.0, "Size at which a new file is begun; 0: never.", "MB", 0.0, 1e6, read_only=True)
    max_part_s: float = setting(0.0, "Duration at which a new file is begun; 0: never.", "s", 0.0, 1e6, read_only=True)


@dataclass(frozen=True)
class Settings:
    """All groups together; immutable."""

    arm: ArmSettings = ArmSettings()
    control: ControlSettings = ControlSettings()
    singularity: SingularitySettings = SingularitySettings()
    limits: LimitSettings = LimitSettings()
    obstacles: ObstacleSettings = ObstacleSettings()
    target: TargetSettings = TargetSettings()
    path: PathSettings = PathSettings()
    jog: JogSettings = JogSettings()
    state: StateSettings = StateSettings()
    follow: FollowSettings = FollowSettings()
    recording: RecordingSettings = RecordingSettings()

    def flat(self) -> dict[str, Value]:
        """Parameter name -> value."""
        return {name: getattr(group, entry.name) for name, group, entry in _walk(self)}

    def with_values(self, values: Mapping[str, Any]) -> Settings:
        """A copy with these parameters (by full name) changed.

        Raises SettingsError naming the parameter: unknown (with the valid names), of the wrong type, or out of range.
        """
        places = {name: (group, entry) for name, group, entry in _walk(self)}
        changed: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            if name not in places:
                raise SettingsError(f"unknown parameter '{name}'; valid: {', '.join(sorted(places))}")
            group, entry = places[name]
            kept = tuple(value) if isinstance(entry.default, tuple) and isinstance(value, (list, tuple)) else value
            if isinstance(entry.default, float) and isinstance(value, int) and not isinstance(value, bool):
                kept = float(value)
            changed.setdefault(_attribute(group), {})[entry.name] = kept
        groups = {attribute: dataclasses.replace(getattr(self, attribute), **new) for attribute, new in changed.items()}
        return dataclasses.replace(self, **groups)


def _attribute(group: Group) -> str:
    return next(entry.name for entry in dataclasses.fields(Settings) if type(group) is type(entry.default))


def _walk(settings: Settings) -> Iterator[tuple[str, Group, dataclasses.Field[Any]]]:
    for group_entry in dataclasses.fields(settings):
        group = getattr(settings, group_entry.name)
        prefix = getattr(group, "prefix", "")
        for entry in dataclasses.fields(group):
            yield (f"{prefix}.{entry.name}" if prefix else entry.name), group, entry


def describe() -> tuple[Descriptor, ...]:
    """Every parameter in declaration order, for the node, the README table and the command lines."""
    return tuple(
        Descriptor(name=name, default=getattr(group, entry.name), **entry.metadata)
        for name, group, entry in _walk(Settings())
    )
