"""Kinetic energy of the commands, gravitational energy and repulsion over a run."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.clearances import ClearanceSeries
from ik_node.robot.robot import Robot

GRAVITY, REPULSION = "gravitational energy", "repulsion of near pairs"
POTENTIALS = {"gravity_gradient": GRAVITY, "obstacle_gradient": REPULSION}
"""Method -> its potential h. The repulsion is that at q; the method also uses that at the predicted position."""


class EnergyMetrics(NamedTuple):
    """Kinetic energy 1/2 qd' M qd of the commands, both potentials, and that of the method; NaN where there is none."""

    kinetic_mean_j: float
    kinetic_max_j: float
    gravitational_mean_j: float
    """Of the measured positions, with the zero of Pinocchio: at the height of the base."""
    repulsion_mean_j: float
    """Of near pairs, with the bounds of this run, also when its method does not use it."""
    potential: str
    """What h is; empty when the method has no potential."""
    potential_first_j: float
    """At the first measured position."""
    potential_last_j: float
    potential_max_j: float


class EnergySeries(NamedTuple):
    """Energies over time."""

    times_s: Array
    """(k,), on the axis of ``Run.times_s``."""
    kinetic: Array
    """(k,), J; NaN without a measured position."""
    gravitational: Array
    """(k,), J; NaN without a measured position."""
    repulsion_times_s: Array
    """(r,)"""
    repulsion: Array
    """(r,), J; empty without distances."""


def energies(
    run: Run, robot: Robot, method: str, clearance_series: ClearanceSeries | None
) -> tuple[EnergyMetrics, EnergySeries]:
    """Energies of a run.

    Args:
        run: The recorded run.
        robot: Its robot.
        method: Its method, which has the potential.
        clearance_series: Its distances, for the potential of ``obstacle_gradient``.
    """
    known = np.asarray(np.isfinite(run.q).all(axis=1) & np.isfinite(run.joint_velocity).all(axis=1))
    kinetic, gravitational = np.full(len(known), np.nan), np.full(len(known), np.nan)
    for row in np.flatnonzero(known).tolist():
        kinetic[row] = robot.kinetic_energy(run.q[row], run.joint_velocity[row])
        gravitational[row] = robot.gravitational_energy(run.q[row])
    times_s, repulsion = np.empty(0), np.empty(0)
    if clearance_series is not None:
        times_s, repulsion = clearance_series.times_s, clearance_series.repulsion
    name = POTENTIALS.get(method, "")
    potential = {GRAVITY: gravitational[known], REPULSION: repulsion}.get(name, np.empty(0))
    metrics = EnergyMetrics(
        kinetic_mean_j=_mean(kinetic[known]),
        kinetic_max_j=float(kinetic[known].max()) if known.any() else math.nan,
        gravitational_mean_j=_mean(gravitational[known]),
        repulsion_mean_j=_mean(repulsion),
        potential=name if len(potential) else "",
        potential_first_j=float(potential[0]) if len(potential) else math.nan,
        potential_last_j=float(potential[-1]) if len(potential) else math.nan,
        potential_max_j=float(potential.max()) if len(potential) else math.nan,
    )
    return metrics, EnergySeries(run.times_s, kinetic, gravitational, times_s, repulsion)


def _mean(values: Array) -> float:
    return float(values.mean()) if len(values) else math.nan
