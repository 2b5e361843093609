"""Velocity dampers: linear constraints on the joint velocity that bound the speed of approach (Faverjon and
Tournassoud, ICRA 1987)."""

from __future__ import annotations

from typing import NamedTuple

from ik_node.math.types import Array


class VelocityDampers(NamedTuple):
    """Linear constraints ``rows`` qd >= ``least`` that bound the speed of approach of pairs of bodies."""

    rows: Array
    """Gradients of the distances, (k, n), m per rad (m per m)."""
    least: Array
    """Lower bounds of the rates of the distances, (k,), m/s."""
    names: tuple[str, ...]
    """Names of the pairs, k of them."""
