"""Recordings: rosbag2-style MCAP directories, written off the control path and read back as a run."""
