"""Collision geometry, distances and the terms of the differential inverse kinematics that avoid collisions.

:mod:`.geometry` makes one convex solid per link from the URDF (:mod:`.bounding_capsule` optionally a capsule), and
:mod:`.pair_selection` selects the pairs of links whose distances are computed. :mod:`.scene` holds the obstacles, from
messages or from a YAML file. :class:`.distances.DistanceQuery` computes the distances of all pairs at a joint position,
with the compiled functions of :mod:`.distance_kernels`. :mod:`.avoidance` turns them into a repulsive potential and
:class:`.velocity_damper.VelocityDampers`. :class:`.monitor.CollisionMonitor` combines these for one arm:

    obstacle samples -> update_obstacles() -> Scene
    q, qd -> update() -> AvoidanceTerms (potential, dampers, closest pair)
"""

from ik_node import dependencies

dependencies.check(dependencies.ROBOTICS)
