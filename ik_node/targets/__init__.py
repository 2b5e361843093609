"""Targets: from received poses, paths, trajectories and twists to one smooth reference motion.

``arbiter`` selects the active input. Each kind of target has its own source of the reference: ``stream`` (poses),
``path`` (paths and trajectories), ``jog`` (twists). At every control step the active source returns the desired pose
T_sd and the desired twist V_d; on a change of input the new one takes over position, velocity and acceleration.

Common parts: ``jerk_limited_filter`` (cascade with bounded speed, acceleration and jerk), ``jerk_schedule`` (jerks of
one control interval), ``transition`` (onto another motion without a jump) and ``bounds`` (bounds per kind of target).
"""
