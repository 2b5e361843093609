"""The viewer's page of a running node.

``listener.LiveViewListener`` subscribes to the node's topics, keeps the newest message of each as bytes, and requests
the node's parameters. ``live_timeline.LiveTimeline`` decodes these messages 30 times per second into a frame of the
viewer's timeline; what the node does not publish (singular values, closest points) is computed from the joint
positions. ``app.view_live`` connects both with a ``viewer.page.ViewerPage``.
"""
