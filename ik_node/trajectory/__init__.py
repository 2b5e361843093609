"""Known trajectories: poses as functions of time, from formulas or from files.

``shapes`` are trajectories from formulas, at rest at both ends. ``pose_file`` loads recorded poses of other projects:
``pose_table`` reads rows and columns of a file (CSV, text, NPY), ``pose_columns`` finds the columns of position,
quaternion and time, ``pose_file_format`` holds the options, and ``sampled`` interpolates the samples.

These are sources of targets for demonstrations, tests and benchmarks; the controller does not use them.
"""
