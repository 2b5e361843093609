"""Cartesian velocity control of robot arms: twist feedback with feed-forward, resolved by a selectable pseudoinverse."""

__version__ = "0.1.0"
