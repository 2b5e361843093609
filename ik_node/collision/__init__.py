"""Collision geometry, distances and the terms of the differential inverse kinematics that avoid collisions.

:mod:`.geometry` makes one convex solid per link from the URDF (:mod:`.bounding_capsule` optionally a capsule), and
:mod:`.pair_selection` selects the pairs of links whose distances are computed. :mod:`.scene` holds the obstacles, from
messages or from a YAML file, and :mod:`.obstacle_arrays` their poses and motions as arrays. At a joint position
:class:`.distances.DistanceQuery` finds the pairs that are near by the bounds of :mod:`.distance_bounds`, computes their
distances by :mod:`.convex_distances` and their gradients by :mod:`.distance_kernels`. :mod:`.avoidance` turns them
into a repulsive potential and :class:`.velocity_damper.VelocityDampers`. :class:`.monitor.CollisionMonitor` combines
these for one arm:

    obstacle samples -> update_obstacles() -> Scene
    q, qd -> update() -> AvoidanceTerms (potential, dampers, closest pair)
"""

from ik_node import dependencies

dependencies.check(dependencies.ROBOTICS)
