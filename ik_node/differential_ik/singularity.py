"""Regulation near singularities: which part of a twist is executed, and at which scale.

With D J = U S Y' (rows scaled by D, so that rotations are comparable with translations) the twist V requires the rate
alpha_i = u_i' D V / sigma_i along y_i. If sigma_i is small, the joints cannot reach that rate. There are two remedies:
scaling V down costs time, truncating the direction costs accuracy. Each is wrong in some cases. Scaling down never ends
if the pose is out of reach; truncation bends paths that the arm could follow. The cases differ in how sigma changes
when the arm moves on:

wrist-like     Motion along y turns u: the critical direction moves away while the arm waits, as the angle of polar
               coordinates turns by pi when a path passes close to their origin. Scaling down succeeds, in the time that
               this turn takes.
boundary-like  Motion along y changes sigma itself: at a stretched elbow sigma vanishes within sigma / |h| rad, with
               h = d sigma / d alpha. Towards the boundary waiting gains nothing: the rate is reduced to zero as that of
               a joint near its limit, and the rest of the twist continues. Away from it the arm is soon free.
near miss      Passing at less than ``tolerance`` is not worth half a turn of the wrist: the direction is truncated, and
               the error stays below about that length.

Therefore every direction has a retention in 0..1: 1 retains the direction of V and scales V down, 0 continues at full
speed with the rate clipped to what is feasible. It is the product of smoothsteps of

* sigma* relative to the tolerance, where sigma* = sigma |w| / hypot(w, d sigma / dt) is the smallest sigma on the way
  if the arm continues straight on. An intermediate decision would cost both time and accuracy; so this one is taken
  before the arm slows down, kept while it does (unless sigma* turns out three times larger or smaller), and executed
  within ``TRANSITION_S``;
* sigma / |h|, only towards a boundary; away from a boundary it is 1;
* the time lost so far: after ``timeout_s`` the direction is truncated whatever the reason of the delay was, for
  instance a joint limit in the way of the turn.

The singularity scale is the largest factor <= 1 on V at which the rates are within the joints' speeds and the *change*
of the joint velocities along the path is within their accelerations: qd_e(q) = J^-1 V changes by
scale^2 (d qd_e/dq) qd_e. This slows the arm down early enough; the limits of one control step would act too late and
bend the path during braking. It is a wish: where the joints cannot brake to it along V, s is larger.

A boundary has two branches (an elbow bent either way), and at the boundary itself a small motion changes them. The
branch that the arm came from is tracked (:mod:`ik_node.differential_ik.singularity_branch`): an arm on the other branch
that is to return first crosses the boundary, which hardly moves the tool, and then goes back the way it came.

On a path whose joint motion ahead is known (:mod:`ik_node.targets.path.foresight`), all this is superfluous: its rate
is one that the joints can follow, while sigma* and the scales above suppose that V remains as it is, and would truncate
what the joints can execute. There V is followed with the damped rates of the prediction, until a limit stops the arm
for ``timeout_s``.

For sigma below ``tolerance`` the rate is w / max(sigma, tolerance / 2 ...): bounded, and not zero at an exactly
singular start, so that the arm gets away; it continues to turn in the present direction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.differential_ik.singular_directions import (
    DirectionFigures,
    JacobianAt,
    SingularDirections,
    analyse,
    bounded_rates,
    clip_rate,
    continuing_rates,
    directions_to_differentiate,
    jacobians_beside,
    motion_of_others,
    needs_no_regulation,
)
from ik_node.differential_ik.singularity_branch import Branch, track_branch
from ik_node.differential_ik.viable_scale import MIN_RATE
from ik_node.jit import compiled
from ik_node.math.numerics import smoothstep, smoothstep_ratio
from ik_node.math.pseudoinverse import Decomposition
from ik_node.math.types import Array
from ik_node.robot.chain import PATH_DAMPING
from ik_node.robot.joint_limits import JointBounds, MotionLimits
from ik_node.settings.groups import SingularitySettings

TRUNCATION_S = 0.5
"""Duration of the transition to truncation after the timeout."""

MAX_EXTRA_DELAY_S = 1.0
"""Delay counted beyond timeout and transition; this long after the singularity the timeout is available again."""

REST_FRACTION = 0.02
"""If all joints move at less than this fraction of their speeds the arm is stuck; its delay counts five times."""

MIN_SCALE = 1e-9
"""Smallest divisor of a scale."""

MIN_SIGMA = 1e-6
"""Singular values are raised to this one, m, so that the regulated task is never singular."""

TRANSITION_S = 0.1
"""Duration of the transition between retaining a direction and truncating it."""

MAX_ALONGSIDE_S = 0.2
"""Maximum time spent beside a singularity while passing it."""

FADE_RATIO = 0.4
"""Ratio of sigma to its threshold below which a direction that is passed straight fades out."""

HYSTERESIS = 3.0
"""Factor by which sigma* has to change, once the arm slows down, to change the decision."""


class SingularityState(NamedTuple):
    """State from one control step to the next; :data:`START` at first."""

    delay_s: float
    """Time lost so far, s."""
    decision: str
    """``free``: no decision is needed; ``keep``: scale V down; ``pass``: pass straight and truncate."""
    retention: float
    """Progress of the decision: 1 scales down, 0 truncates."""
    alongside_s: float
    """For how long the arm has been passing straight without getting past, s."""
    branch: Branch | None = None
    """The branch that the arm came from; None away from singularities."""


START = SingularityState(0.0, "free", 1.0, 0.0)


class RegulatedTask(NamedTuple):
    """The task that replaces J qd = V."""

    jacobian: Array
    """J with singular values raised to ``MIN_SIGMA``; J itself away from singularities."""
    twist: Array
    """V_f = V - ``truncated``, (6,), as ``jacobian`` attains it."""
    truncated: Array
    """The part of V that is truncated, (6,); zero if V is only scaled down."""
    singularity_scale: float
    """Scale s that is wished for, in (0, 1]."""
    retention: float
    """Smallest retention of a direction: 1 retained, 0 truncated."""
    kept: Array
    """Fraction of the rate along each singular direction that V_f keeps, (6,), -1 to 1."""
    singular_values: Array
    """Of D J, descending, m."""
    svd: Decomposition | None
    """Decomposition of D times ``jacobian``; None if that is not J itself."""
    state: SingularityState
    """Argument of the next call."""


def regulate_singularities(
    jacobian_at: JacobianAt,
    q: Array,
    jacobian: Array,
    twist: Array,
    previous: Array,
    bounds: JointBounds,
    limits: MotionLimits,
    row_scale: Array,
    svd: Decomposition,
    settings: SingularitySettings,
    state: SingularityState,
    elapsed_s: float,
    scale_before: float = 1.0,
    foreseen: bool = False,
) -> RegulatedTask:
    """The part of V that is executed in this control step, and its scale; see the module.

    Args:
        jacobian_at: J (m, n) of joint positions near q.
        q: Joint positions, (n,), rad (m).
        jacobian: J at q, (m, n).
        twist: V, (m,), in the frame of J.
        previous: The present command, (n,), rad/s (m/s).
        bounds: Limits of this control step.
        limits: Limits of the joints.
        row_scale: D, (m,).
        svd: Decomposition of D J.
        settings: Threshold, tolerance and timeout.
        state: ``state`` of the last result.
        elapsed_s: For how long the present command has been held, s.
        scale_before: Scale s that the limits permitted in the last control step.
        foreseen: True on a path whose rate is one that the joints can follow, also ahead.
    """
    size = len(svd.sigma)
    u, sigma, rows = svd.u, svd.sigma, svd.vt[:size]
    if sigma[-1] >= settings.threshold:
        free = SingularityState(max(0.0, state.delay_s - elapsed_s), "free", 1.0, 0.0)
        return RegulatedTask(jacobian, twist, np.zeros(len(twist)), 1.0, 1.0, np.ones(size), sigma, svd, free)
    near = SingularDirections(row_scale, u, sigma, rows, u.T @ (row_scale * twist), settings.tolerance)
    branch = track_branch(state.branch, u[:, -1], rows[-1], float(sigma[-1]) / settings.threshold)
    in_time = 1.0 - smoothstep((state.delay_s - settings.timeout_s) / TRUNCATION_S)
    required = bounded_rates(sigma, near.along, near.tolerance)
    is_free = foreseen or (state.retention == 1.0 and needs_no_regulation(near, required, limits))
    if is_free and state.delay_s <= settings.timeout_s:
        free = START._replace(delay_s=_delay(state.delay_s, scale_before, elapsed_s, previous, limits), branch=branch)
        if foreseen:
            return _on_path(jacobian, twist, row_scale, svd, near.along, free)
        return RegulatedTask(jacobian, twist, np.zeros(len(twist)), 1.0, 1.0, np.ones(size), sigma, svd, free)
    first = int(np.count_nonzero(sigma >= settings.threshold))
    crossed = branch is not None and branch.crossed
    wanted = continuing_rates(near, required, first, size - 1 if crossed else size, previous, bounds)
    beside = jacobians_beside(jacobian_at, q, directions_to_differentiate(near, wanted, first))
    figures = analyse(near, wanted, first, beside, limits)
    speed_scale = float(np.minimum(1.0, figures.max_rate / np.maximum(np.abs(wanted[first:]), 1e-30)).min())
    after = _decide(
        state,
        float(figures.min_sigma[-1]),
        float(sigma[-1]),
        settings.tolerance,
        min(figures.turn_scale, speed_scale),
        elapsed_s,
        scale_before,
    )
    turns_back = bool(crossed and figures.leaves_boundary[-1] and figures.boundary_distance[-1] < 0.5)
    found = _regulated(
        near,
        required,
        wanted,
        first,
        figures,
        in_time,
        after.retention,
        turns_back,
        settings.threshold,
        previous,
        bounds,
    )
    regular = _regular(jacobian, row_scale, svd)
    max_delay_s = settings.timeout_s + TRUNCATION_S + MAX_EXTRA_DELAY_S
    delay_s = min(_delay(state.delay_s, found.scale * scale_before, elapsed_s, previous, limits), max_delay_s)
    return RegulatedTask(
        regular,
        found.twist,
        found.truncated,
        found.scale,
        found.retention,
        found.kept,
        sigma,
        svd if regular is jacobian else None,
        after._replace(delay_s=delay_s, branch=branch),
    )


def _on_path(
    jacobian: Array, twist: Array, row_scale: Array, svd: Decomposition, along: Array, state: SingularityState
) -> RegulatedTask:
    """The task on a path that is foreseen: V at the damped rates that its prediction has, at full scale.

    The damping ends at ten times its value, so that V_f = V further away from the singularity (S. K. Chan, P. D.
    Lawrence, "General inverse kinematics with the error damped pseudoinverse", ICRA 1988).
    """
    sigma = svd.sigma
    damping = PATH_DAMPING * np.maximum(1.0 - (sigma / (10.0 * PATH_DAMPING)) ** 2, 0.0)
    kept = sigma * sigma / (sigma * sigma + damping * damping)
    truncated = (svd.u @ ((1.0 - kept) * along)) / row_scale
    regular = _regular(jacobian, row_scale, svd)
    own_svd = svd if regular is jacobian else None
    return RegulatedTask(regular, twist - truncated, truncated, 1.0, 1.0, np.ones(len(sigma)), sigma, own_svd, state)


def _regular(jacobian: Array, row_scale: Array, svd: Decomposition) -> Array:
    """J with singular values raised to ``MIN_SIGMA``; J itself away from singularities."""
    if svd.sigma[-1] >= MIN_SIGMA:
        return jacobian
    return np.asarray(((svd.u * np.maximum(svd.sigma, MIN_SIGMA)) @ svd.vt[: len(svd.sigma)]) / row_scale[:, None])


class _RegulatedTwist(NamedTuple):
    """Fields of a :class:`RegulatedTask`."""

    twist: Array
    truncated: Array
    scale: float
    retention: float
    kept: Array


@compiled
def _regulated(
    near: SingularDirections,
    required: Array,
    wanted: Array,
    first: int,
    figures: DirectionFigures,
    in_time: float,
    decided: float,
    turns_back: bool,
    threshold: float,
    previous: Array,
    bounds: JointBounds,
) -> _RegulatedTwist:
    """What is left of the twist. ``required`` (m,): rates of V. ``wanted`` (m,): the same, continuing the present
    motion. ``first``: index of the first critical direction. ``decided``: retention of the decision. ``turns_back``:
    from the other branch the way out leads back through the boundary."""
    sigma, size, tolerance = near.sigma, len(near.sigma), near.tolerance
    wanted = wanted.copy()
    motion = motion_of_others(near, wanted, first)
    if turns_back:
        wanted[-1] = -wanted[-1]
    retention, clipped, scale = np.ones(size), wanted.copy(), 1.0
    for index in range(first, size):
        row = index - first
        distance, max_rate = figures.boundary_distance[row], figures.max_rate[row]
        retention[index] = in_time * decided * distance
        if figures.leaves_boundary[row]:
            # At the boundary itself the other directions need not wait until the arm has turned round.
            away = smoothstep(sigma[index] / tolerance - 1.0)
            retention[index] = in_time * max(decided, 1.0 - distance) * (distance + (1.0 - distance) * away)
        if turns_back and index == size - 1:
            retention[index] = 0.0
        fastest = _max_rate(max_rate, sigma[index], near.along[index], decided, threshold)
        clipped[index] = clip_rate(near.rows[index], wanted[index], fastest, motion, previous, bounds)
        scale = min(scale, min(1.0, max_rate / max(abs(wanted[index]), 1e-30)) ** retention[index])
    # At less than the tolerance the derivatives are meaningless.
    scale = min(scale, figures.turn_scale ** (retention[first:].max() * smoothstep(sigma[-1] / tolerance - 1.0)))
    # Fades in below the threshold, so that there is no step at the threshold.
    scale = 1.0 - (1.0 - scale) * smoothstep((threshold - sigma[-1]) / (0.3 * threshold))
    twist, truncated, kept = np.zeros(len(near.row_scale)), np.zeros(len(near.row_scale)), np.ones(size)
    for index in range(size):
        rate = wanted[index]
        if index >= first:
            # Completely clipped below a retention of 1/2: any remainder of a blocked direction would block everything.
            retained = max(2.0 * retention[index] - 1.0, 0.0)
            rate = retained * rate + (1.0 - retained) * _at_full_speed(clipped[index], wanted[index], scale)
        twist += near.u[:, index] * (max(sigma[index], MIN_SIGMA) * rate)
        if retention[index] < 1.0 or sigma[index] < tolerance:
            truncated += near.u[:, index] * (near.along[index] - rate * sigma[index])
        if abs(required[index]) > MIN_RATE:
            kept[index] = min(max(rate / required[index], -1.0), 1.0)
    return _RegulatedTwist(
        twist / near.row_scale, truncated / near.row_scale, scale, float(retention[first:].min()), kept
    )


@compiled
def _at_full_speed(clipped: float, wanted: float, scale: float) -> float:
    """Rate of V_f that is the clipped one at this scale, up to the wanted one.

    A direction that went on faster than V does at this scale would lead the tool off the direction of V_f. A rate that
    bounds force beyond the wanted one remains as it is: divided by a vanishing scale it would be unlimited.
    """
    if clipped * wanted < 0.0 or abs(clipped) > abs(wanted):
        return clipped
    return float(min(max(clipped / max(scale, MIN_SCALE), -abs(wanted)), abs(wanted)))


@compiled
def _max_rate(max_rate: float, sigma: float, along: float, retention: float, threshold: float) -> float:
    """Highest rate of a direction; it fades out with sigma when the arm passes straight, so that the arm hardly turns.

    Half a turn would be worse than a whole one or none.
    """
    ratio = sigma / (FADE_RATIO * threshold)
    if ratio >= 1.0:
        return max_rate
    faded = abs(along) * min(1.0, smoothstep_ratio(ratio)) / (FADE_RATIO * threshold)
    return float(retention * max_rate + (1.0 - retention) * min(max_rate, faded))


def _decide(
    state: SingularityState,
    min_sigma: float,
    sigma: float,
    tolerance: float,
    scale: float,
    elapsed_s: float,
    scale_before: float,
) -> SingularityState:
    """Decides whether to pass the singularity straight, and advances the transition."""
    decision, alongside_s = state.decision, 0.0
    if scale > (0.99 if decision == "free" else 0.995):
        decision = "free"
    elif decision == "pass":
        if min_sigma > HYSTERESIS * tolerance:
            decision = "keep"
        elif min_sigma > 0.9 * sigma or scale_before < 0.5:
            alongside_s = state.alongside_s + elapsed_s
            decision = "pass" if alongside_s < MAX_ALONGSIDE_S else "keep"
    else:
        # Only an arm that is still approaching can pass straight; at the singularity it has to turn.
        limit = tolerance if decision == "free" else tolerance / HYSTERESIS
        decision = "pass" if min_sigma < min(limit, 0.5 * sigma) else "keep"
    change = elapsed_s / TRANSITION_S
    retention = max(0.0, state.retention - change) if decision == "pass" else min(1.0, state.retention + change)
    return SingularityState(state.delay_s, decision, retention, alongside_s)


def _delay(delay_s: float, scale: float, elapsed_s: float, previous: Array, limits: MotionLimits) -> float:
    """Time lost so far, s."""
    if scale > 0.9:
        return max(0.0, delay_s - elapsed_s)
    at_rest = bool((np.abs(previous) < REST_FRACTION * limits.velocity).all())
    return delay_s + elapsed_s * (1.0 - scale) * (5.0 if at_rest else 1.0)
