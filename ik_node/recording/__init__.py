"""Recordings of runs as rosbag2-style MCAP directories.

Writing: ``run_recorder`` stores input messages, controller calls, Steps, outputs and snapshots of the controller;
``mcap`` writes the files in a thread, so that the control loop does not wait for the disk. Reading: ``call_log`` gives
calls and snapshots in recorded order for a replay, ``run_reader`` the whole run as arrays (``run``), which ``export``
writes as CSV or JSON. ``input_table`` lists the input topics with their decoders, ``environment`` the versions on which
bits depend, ``json_codec`` encodes snapshots.

    calls, messages, Steps -> RunRecording -> mcap.writer -> files -> mcap.reader -> RecordedCalls, Run

This package knows the controller only by the names of its calls: reading a recording loads neither Pinocchio nor numba.
"""
