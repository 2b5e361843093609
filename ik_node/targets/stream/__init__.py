"""Streams of target poses: from irregular samples to a smooth reference motion.

Data flow, per sample: ``stream`` (duplicates, reordering, jumps, gaps) -> ``sampling_clock`` (regular sample times) ->
``predictors`` (weighted polynomials) -> ``extrapolation`` (the predicted curve) and ``latency`` (the delay behind
unpredictable targets);
``target_speed`` warns of a target that is faster than the reference may be.

Per control step: ``tracking_filter`` evaluates the curve and leads the reference to it within the bounds on speed,
acceleration and jerk; it yields the desired pose and the desired twist.
"""
