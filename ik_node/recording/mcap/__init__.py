"""MCAP files in the layout of rosbag2, without ROS.

``writer`` queues messages and writes chunks in a thread with ``file``; ``metadata`` describes topics and makes
``metadata.yaml``. ``reader`` returns messages in the order in which they were written, also of files that were cut off,
and ``repair`` completes such files; both read records with ``scan``.
"""
