"""Inverse kinematics: joint positions for a pose of the tool.

``newton_raphson`` holds the algorithms of the lecture notes with the table of all iterates: root finding, the
coordinate form and the body-twist form. ``pose_solver`` is the solver for applications: damped steps, joint limits,
restarts, a bounded number of iterations, a part of the pose; ``solve_pose`` is part of the library. ``least_motion``
moves its solutions towards the seed. ``worked_examples`` are those of the notes; ``iteration_table`` and
``iteration_figure`` show iterates as text, JSON and pictures.

Data: a pose T_sd (4, 4) and a start or seed q (n,) go in; a PoseSolution with the joint positions, the reason of the
end and the iterates comes out. The kinematics are those of a Robot or a ScrewChain.
"""
