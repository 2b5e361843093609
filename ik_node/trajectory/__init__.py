"""Known trajectories: poses as functions of time, from formulas or from files.

``shapes`` are trajectories from formulas, at rest at both ends. ``pose_reader`` reads the files of poses of other
projects: ``pose_text`` (CSV, text, NPY), ``pose_json`` and ``pose_bag`` make a ``pose_table`` of rows and columns,
``pose_columns`` finds the columns of position, orientation and time by their ``column_names`` or by a table of layouts,
``orientations`` converts quaternions, angles and matrices, and ``pose_file_format`` holds the options. ``pose_file``
makes trajectories of the poses, which ``sampled`` interpolates.

These are sources of targets for demonstrations, tests and benchmarks, and of the ground truth of reports; the
controller does not use them.
"""
