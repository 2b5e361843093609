"""Paths and trajectories: from a list of poses to a reference motion.

Data flow at arrival: ``request`` (checks, transformation to {s}) -> ``spline_fit`` (velocities and accelerations at the
poses) -> ``se3_spline`` (C2 motion). Paths without time stamps also get times: ``time_parametrisation`` (bounds of tool
and joints) -> ``time_scaling`` (path parameter over time).

Per control step: ``follower`` (approach, start, progress) with ``speed_ramp`` and the transition onto the path;
``timed_path`` evaluates the spline and the time scaling.
"""
