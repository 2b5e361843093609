"""CDR bytes of ROS messages <-> plain data, without rclpy or ROS message packages.

The node subscribes and publishes raw bytes, so the same functions serve the node, the recording, the replay and the
tests. Encoding is deterministic: equal content gives equal bytes.

- ``cdr``: typestore of `rosbags`, templates of messages with a fixed layout, and a reader of CDR fields.
- ``decode``, ``decode_targets``, ``decode_obstacles``: input messages -> samples of ``interfaces.samples``.
- ``encode``, ``step_outputs``: results of a Step -> output messages; ``markers``: scene and path for RViz.
- ``step_codec``: Steps and controller calls <-> messages of a recording; ``parameters``: the same for parameters.
- ``restamp``: recorded messages with later stamps.

Reading a recording needs none of ``step_outputs`` and ``markers``, the only modules here that load compiled code.
"""
