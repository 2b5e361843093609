"""Robot arms: kinematics, dynamics and limits of the controlled joints, and a simulated arm.

:func:`.catalogue.load_robot` loads a robot by name (example-robot-data), from a URDF file or from URDF text:

    URDF -> description (checks; tool: optional tool link) -> reduced_model (fixes other joints), mimic -> robot.Robot

:class:`.robot.Robot` gives pose and body Jacobian (records in :mod:`.kinematics`), mass matrix and gravity at joint
positions q. :class:`.screw_chain.ScrewChain` has the same interface for arms defined by screw axes.
:mod:`.joint_limits` turns the limits of URDF and settings into bounds on the joint velocity of one control step.
:mod:`.frames` gives the poses of the frames of targets and obstacles, :mod:`.srdf` reads the disabled collision pairs,
:mod:`.task_rank` states what an arm can follow of a task, and :class:`.simulated_arm.SimulatedArm`
integrates velocity commands.
"""
