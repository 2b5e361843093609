"""Near singularities: which part of a twist can still be had, and how fast.

With D J = U S Y' (rows scaled by D, so that rotations compare with translations) the twist V asks for the rate
alpha_i = u_i' D V / sigma_i along y_i. Where sigma_i is small that is more than joints can do, and there are two ways
out: go slower, which costs time, or let go of the direction, which costs accuracy. Each is wrong somewhere. Slowing
down never ends where the pose is out of reach; letting go bends paths that could have been followed. What tells them
apart is what happens to sigma when the arm moves on:

wrist-like     Motion along y turns u: the lost direction wanders off while the arm waits (think of polar coordinates
               at their origin: to pass at a small distance, the angle has to turn by half a circle). Slowing down
               succeeds, in the time that this turn takes.
boundary-like  Motion along y changes sigma itself (a stretched elbow: sigma falls to zero within ``sigma / |h|`` rad,
               h = d sigma / d alpha). Towards the boundary nothing is gained by waiting: the rate is led to zero like a
               joint that nears its limit, and the rest of the twist goes on. Away from it the arm is free in a moment.
missed by less Passing closer than ``tolerance`` is not worth half a turn of the wrist: the direction is let go, the
               error stays below about that length.

So every direction has a weight ``keep`` in 0..1: 1 keeps V's direction and slows it down, 0 goes on at full pace with
the rate clipped to what is possible. It is the product of smooth steps in

* sigma* against tolerance, sigma* = sigma |w| / hypot(w, d sigma / dt) being the smallest sigma on the way if the arm
  goes straight on. Half a decision would cost both time and accuracy, so this one is taken before the arm slows down,
  kept while it does (unless sigma* turns out three times larger or smaller), and carried out within ``TURNING_S``;
* sigma / |h|, only towards a boundary; away from a boundary it is 1;
* the time that was lost so far: after ``patience_s`` it lets go, whatever the reason was, for instance a joint limit in
  the way of the turn.

The pace is the largest factor <= 1 with which the rates stay within the joints' speeds, and with which the *change* of
the joint velocities along the path stays within their accelerations: qd_e(q) = J^-1 V changes by pace^2 (d qd_e/dq)
qd_e. That slows down early enough; the box alone would notice too late and bend the path while braking.

A boundary has two sides (an elbow bent either way), and at the boundary itself a breath of motion changes them. The
side that the arm came from is remembered (:mod:`ik_node.differential_ik.singularity_branch`): who is on the other one and is called back goes
through the boundary first, which costs the tool next to nothing, and then back the way it came.

At sigma below ``tolerance`` the rate is w / max(sigma, tolerance / 2...): bounded, and not zero at an exactly singular
start, so that it gets away; the side to turn to is the one it already turns to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.differential_ik.singular_directions import (
    JacobianAt,
    Neighbourhood,
    clip,
    look,
    same_side,
    slow_enough,
    smooth_step,
)
from ik_node.differential_ik.singularity_branch import Branch, follow_branch
from ik_node.math.pseudoinverse import Decomposition, decompose
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds, MotionLimits
from ik_node.settings.groups import SingularitySettings

LETTING_GO_S = 0.5
"""How long the change takes once patience is over."""

MOST_LOST_S = 1.0
"""Time lost beyond what patience and letting go take does not count: patience comes back this long after the end."""

AT_REST = 0.02
"""An arm whose joints all move at less than this part of their speeds is stuck, not slow: time counts five times."""

FLOOR = 1e-6
"""Singular values are raised to this one, m, so that the problem handed on is never singular."""

TURNING_S = 0.1
"""How long the change between keeping a direction and letting it go takes."""

LONGEST_ABREAST_S = 0.2
"""Who stays beside a singularity for longer than this is not passing it."""

FADING = 0.4
"""Part of the threshold below which a direction that is passed straight by fades out."""

HESITATION = 3.0
"""Once the arm slows down, sigma* has to be this many times off to change the decision."""


class PassageState(NamedTuple):
    """What one tick hands to the next; :data:`START` at first."""

    lost_s: float
    """Time lost so far, s."""
    decision: str
    """``free``: there is nothing to decide; ``keep``: it slows down; ``pass``: it goes straight by and lets go."""
    kept: float
    """How far the decision is carried out: 1 slows down, 0 has let go."""
    abreast_s: float
    """For how long it has been passing straight by without coming past, s."""
    branch: Branch | None = None
    """The side of the nearest singularity that the arm came from; None away from singularities."""


START = PassageState(0.0, "free", 1.0, 0.0)


class Passage(NamedTuple):
    """What is asked of the arm instead of V."""

    jacobian: Array
    """J with singular values raised to ``FLOOR``; J itself away from singularities."""
    twist: Array
    """V_f times ``pace``, (6,)."""
    lost: Array
    """What was given up of V, (6,); zero where it is only slowed down."""
    pace: float
    """In (0, 1]: how much slower than V."""
    keep: float
    """Smallest weight of a direction: 1 kept, 0 let go."""
    singular_values: Array
    """Of D J, descending, m."""
    parts: Decomposition | None
    """Of D times ``jacobian``; None where that is not J itself."""
    state: PassageState
    """To be handed to the next call."""


def pass_singularities(
    jacobian_at: JacobianAt,
    q: Array,
    jacobian: Array,
    twist: Array,
    previous: Array,
    bounds: JointBounds,
    limits: MotionLimits,
    row_scale: Array,
    settings: SingularitySettings,
    state: PassageState,
    elapsed_s: float,
    scale_before: float = 1.0,
) -> Passage:
    """The part of V that is to be done now, and at what pace; see the module.

    ``jacobian`` J (m, n) at q (n,) and ``twist`` V (m,) in one frame; ``jacobian_at`` gives J nearby. ``previous``
    (n,): the command that stands, for ``elapsed_s``. ``state``: of the last Passage; ``scale_before``: the s that came
    of it.
    """
    parts = decompose(row_scale[:, None] * jacobian, "jacobian")
    size = len(parts.sigma)
    u, sigma, rows = parts.u, parts.sigma, parts.vt[:size]
    if sigma[-1] >= settings.threshold:
        free = PassageState(max(0.0, state.lost_s - elapsed_s), "free", 1.0, 0.0)
        return Passage(jacobian, twist, np.zeros(len(twist)), 1.0, 1.0, sigma, parts, free)
    near = Neighbourhood(jacobian_at, q, row_scale, u, sigma, rows, u.T @ (row_scale * twist), settings.tolerance)
    branch = follow_branch(state.branch, u[:, -1], rows[-1], float(sigma[-1]) / settings.threshold)
    patient = 1.0 - smooth_step((state.lost_s - settings.patience_s) / LETTING_GO_S)
    wanted = near.rates(sigma, near.along)
    if state.kept == 1.0 and state.lost_s <= settings.patience_s and near.easy(wanted, limits):
        lost_s = _count(state.lost_s, scale_before, elapsed_s, previous, limits)
        free = PassageState(lost_s, "free", 1.0, 0.0, branch)
        return Passage(jacobian, twist, np.zeros(len(twist)), 1.0, 1.0, sigma, parts, free)
    few = np.flatnonzero(sigma < settings.threshold).tolist()
    wrong = branch is not None and branch.wrong
    for index in few[:-1] if wrong else few:
        wanted[index] = same_side(near, index, wanted[index], previous, bounds)
    rest = wanted.copy()
    rest[few] = 0.0
    motion = rest @ rows
    drift = near.change(motion)
    views = [look(near, index, wanted[index], drift, limits) for index in few]
    paces = [min(1.0, view.most / max(abs(wanted[index]), 1e-30)) for index, view in zip(few, views, strict=True)]
    turn = slow_enough(near, wanted, limits)
    after = _decide(
        state, views[-1].closest, float(sigma[-1]), settings.tolerance, min(turn, *paces), elapsed_s, scale_before
    )

    back = wrong and views[-1].leaving and views[-1].inside < 0.5
    if back:
        # From the wrong side of a boundary the way out leads back through it.
        wanted[-1] = -wanted[-1]
    keep, clipped, pace = np.ones(size), wanted.copy(), 1.0
    for index, view, own in zip(few, views, paces, strict=True):
        if view.leaving:
            # At the boundary itself the other directions need not wait until the arm has turned round.
            left = smooth_step(float(sigma[index]) / settings.tolerance - 1.0)
            keep[index] = patient * max(after.kept, 1.0 - view.inside) * (view.inside + (1.0 - view.inside) * left)
        else:
            keep[index] = patient * after.kept * view.inside
        if back and index == size - 1:
            keep[index] = 0.0
        # Half a turn would be worse than a whole one or none: who passes straight by hardly turns.
        part = float(sigma[index]) / (FADING * settings.threshold)
        faded = abs(float(near.along[index])) * min(1.0, part * (3.0 - 2.0 * part)) / (FADING * settings.threshold)
        most = view.most if part >= 1.0 else after.kept * view.most + (1.0 - after.kept) * min(view.most, faded)
        clipped[index] = clip(near, index, wanted[index], most, motion, previous, bounds)
        pace = min(pace, own ** keep[index])
    # Nearer than the tolerance the field has no derivative to speak of.
    pace = min(pace, turn ** float(keep[few].max() * smooth_step(sigma[-1] / settings.tolerance - 1.0)))
    # Fades in below the threshold, so that nothing happens at once.
    pace = 1.0 - (1.0 - pace) * smooth_step((settings.threshold - sigma[-1]) / (0.3 * settings.threshold))
    rates = pace * wanted
    # Fully clipped from the middle on: any rest of a blocked direction would hold up everything.
    part_kept = np.maximum(2.0 * keep[few] - 1.0, 0.0)
    rates[few] = part_kept * rates[few] + (1.0 - part_kept) * clipped[few]
    raised = np.maximum(sigma, FLOOR)
    safe = jacobian if sigma[-1] >= FLOOR else ((u * raised) @ rows) / row_scale[:, None]
    done = np.minimum(np.abs(rates), pace * np.abs(wanted)) * np.sign(rates) * sigma / max(pace, 1e-9)
    most_lost_s = settings.patience_s + LETTING_GO_S + MOST_LOST_S
    lost_s = min(_count(state.lost_s, pace * scale_before, elapsed_s, previous, limits), most_lost_s)
    return Passage(
        safe,
        (u @ (raised * rates)) / row_scale,
        (u @ np.where((keep < 1.0) | (sigma < settings.tolerance), near.along - done, 0.0)) / row_scale,
        pace,
        float(keep[few].min()),
        sigma,
        parts if safe is jacobian else None,
        after._replace(lost_s=lost_s, branch=branch),
    )


def _decide(
    state: PassageState,
    closest: float,
    sigma: float,
    tolerance: float,
    pace: float,
    elapsed_s: float,
    scale_before: float,
) -> PassageState:
    """Whether to pass straight by, and how far that is carried out."""
    decision, abreast_s = state.decision, 0.0
    if pace > (0.99 if decision == "free" else 0.995):
        decision = "free"
    elif decision == "pass":
        if closest > HESITATION * tolerance:
            decision = "keep"
        elif closest > 0.9 * sigma or scale_before < 0.5:
            abreast_s = state.abreast_s + elapsed_s
            decision = "pass" if abreast_s < LONGEST_ABREAST_S else "keep"
    else:
        # Only who is still coming nearer passes by; who is there already has to turn.
        sure = tolerance if decision == "free" else tolerance / HESITATION
        decision = "pass" if closest < min(sure, 0.5 * sigma) else "keep"
    change = elapsed_s / TURNING_S
    kept = max(0.0, state.kept - change) if decision == "pass" else min(1.0, state.kept + change)
    return PassageState(state.lost_s, decision, kept, abreast_s)


def _count(lost_s: float, pace: float, elapsed_s: float, previous: Array, limits: MotionLimits) -> float:
    """Time lost so far."""
    if pace > 0.9:
        return max(0.0, lost_s - elapsed_s)
    rest = bool((np.abs(previous) < AT_REST * limits.velocity).all())
    return lost_s + elapsed_s * (1.0 - pace) * (5.0 if rest else 1.0)
