"""The demonstration: node and simulated arm in processes of their own, a streamed trajectory, recording and report.

``demo`` starts the processes and writes the report; ``target_streamer`` is the node that publishes the target poses and
observes joint states and status.
"""
