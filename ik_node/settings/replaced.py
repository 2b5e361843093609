"""Names of parameters of earlier versions, with what replaces them.

Setting such a name raises SettingsError with the text found here, instead of the parameter being ignored.
"""

from __future__ import annotations

from collections.abc import Mapping

PAIRS: Mapping[str, tuple[str, str]] = {
    "gain": ("gain_linear", "gain_angular"),
    "integral_gain": ("gain_integral_linear", "gain_integral_angular"),
    "max_feedback_twist": ("max_feedback_linear", "max_feedback_angular"),
    "target.max_speed": ("target.max_linear_speed", "target.max_angular_speed"),
    "target.max_acceleration": ("target.max_linear_acceleration", "target.max_angular_acceleration"),
    "target.max_jerk": ("target.max_linear_jerk", "target.max_angular_jerk"),
    "path.speed": ("path.linear_speed", "path.angular_speed"),
}
"""New name -> the old names of its elements [linear, angular]."""

RENAMED: Mapping[str, str] = {
    "singularity.patience_s": "singularity.timeout_s",
    "obstacles.strength": "obstacles.repulsion_force",
    "obstacles.damper": "obstacles.velocity_damper",
    "obstacles.evasion_speed": "null_space_speed",
    "obstacles.range": "obstacles.repulsion_range = [obstacles, own links]",
    "obstacles.self_range": "obstacles.repulsion_range = [obstacles, own links]",
    "obstacles.self_stop_distance": "obstacles.stop_distance = [obstacles, own links]",
    "state.max_age_s": "state.max_stamp_age_s",
    "follow.part": "follow.min_ratio",
    **{old: f"{new} = [linear, angular]" for new, pair in PAIRS.items() for old in pair},
}
"""Old name -> new name."""

_BOUNDS = "it follows from target.max_speed, target.max_acceleration and target.max_jerk"
_CONSTANT = "it is a constant"

REMOVED: Mapping[str, str] = {
    "jacobian": "body and space Jacobian give the same joint velocity",
    "singularity_threshold": "singularity.threshold starts the regulation of singularities",
    **dict.fromkeys(("path.max_ahead_s", "path.max_poses", "path.join_distance", "path.join_angle"), _CONSTANT),
    **dict.fromkeys(("min_rate_fraction", "max_integral_linear", "max_integral_angular"), _CONSTANT),
    **dict.fromkeys(("obstacles.look_ahead_s", "obstacles.damper_range"), _CONSTANT),
    **dict.fromkeys(("target.max_age_s", "target.latency_linear", "target.latency_angular"), _CONSTANT),
    **dict.fromkeys(("target.bandwidth", "target.max_bandwidth"), _CONSTANT),
    **dict.fromkeys(("target.catch_up_linear_speed", "target.catch_up_angular_speed"), _BOUNDS),
    **{
        f"path.approach_{half}_{what}": _BOUNDS
        for half in ("linear", "angular")
        for what in ("speed", "acceleration", "jerk")
    },
    **dict.fromkeys(("path.linear_acceleration", "path.angular_acceleration"), _BOUNDS),
    **dict.fromkeys(("jog.max_linear_speed", "jog.max_angular_speed"), _BOUNDS),
    **{f"jog.{half}_{what}": _BOUNDS for half in ("linear", "angular") for what in ("acceleration", "jerk")},
    **dict.fromkeys(("jog.leash_distance", "jog.leash_angle"), _CONSTANT),
    **dict.fromkeys(("follow.least_motion", "follow.window_s", "follow.retry_s"), _CONSTANT),
    **dict.fromkeys(("recording.flush_period_s", "recording.queue_mb"), _CONSTANT),
}
"""Old name -> why there is no such parameter any more."""


def replacement(name: str) -> str:
    """The text for an error about the old parameter ``name``; empty if no earlier version had it."""
    if name in RENAMED:
        return f"parameter '{name}' was replaced by {RENAMED[name]}"
    return f"parameter '{name}' was removed: {REMOVED[name]}" if name in REMOVED else ""
