"""Cartesian velocity control of robot arms: twist feedback, feed-forward, a selectable pseudoinverse."""

__version__ = "0.1.0"
