"""ROS 2 nodes: the controller, a simulated arm, a watchdog, a demonstration, and the live view.

This is the only folder that imports rclpy. ``node`` is a lifecycle node around
:class:`~ik_node.control.controller.Controller`: it subscribes to the bytes of its inputs, decodes them with
:mod:`ik_node.messages`, and makes the calls through a
:class:`~ik_node.replay.recorded_controller.RecordedController`, which publishes the Step (``publisher``) and then
records call and Step (``recorder``). ``parameters`` declares the settings as ROS parameters. ``spin`` runs one node per
process and stops the arm at the end of the process. ``bag_player`` publishes recorded inputs to a running node.
"""
