"""The control loop of one arm: joint states, targets and obstacles in, joint velocity commands out.

:class:`.controller.Controller` receives all inputs. A joint state passes through

    joint_states (assembly, staleness) -> step_timer (rate) -> following_error, state_machine (may the arm move?)
    -> targets (desired motion) -> velocity_controller -> steps (the Step that is published and recorded)

:class:`.velocity_controller.VelocityController` computes the command: :mod:`.feedback` gives the desired twist,
:mod:`.integral_action` and :mod:`.smith_predictor` are optional, and :mod:`ik_node.differential_ik` solves for the
joint velocity within the limits. :mod:`.ramp` brings the arm to rest, :mod:`.status` composes the status text, and
:mod:`.warm_up` calls all compiled functions before the first real run, and :mod:`.compilation` compiles them before the
first warm-up of a version. :mod:`.controller_state` declares the snapshot
of the complete internal state. :mod:`.start_posture` chooses where a simulated arm without a configured start begins.
"""
