"""Differential inverse kinematics: the joint velocity for a desired twist of the tool, within all limits.

:class:`.solver.DifferentialIkSolver` does this at every control step::

    ArmState, twist  ->  collision monitor: velocity dampers, repulsive gradient
                     ->  methods: weight and gradient of the cost; posture: secondary gradients
                     ->  compiled_step: decomposition, closed form, optimum under limits
              else   ->  singularity (singular_directions, singularity_branch): regulated task
                     ->  closed_form: optimum without limits
                     ->  constrained (exact_program, quadratic_program): optimum with limits and dampers
                     ->  deadlock: releases the direction if a limit blocks the arm
                     ->  DifferentialIkSolution

``closed_form.resolve`` and ``constrained.solve`` are part of the library and have no state. ``manipulability`` leads a
redundant arm out of a singularity in which it starts. All twists and Jacobian rows have their linear part first.
"""
