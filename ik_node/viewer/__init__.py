"""3-D view of a run in the browser, served by viser.

A :class:`~ik_node.viewer.timeline.Timeline` holds the fields of Step over time: ``timeline_of`` takes them from a
recorded run, ``ros.live_view`` fills a ring buffer with those of a running node. ``page.ViewerPage`` shows the frame at
the time of its ``Playback``: ``scene_view`` draws robot, paths, frames, multiplier and obstacles, ``plots`` the curves
with a cursor, ``status_html`` values and mode as text. ``meshes`` loads the visual geometry of the URDF,
``recorded_scene`` reconstructs the obstacles of any time, and ``decimation`` reduces lines for display. ``open_run``
assembles the page of a recording.
"""
