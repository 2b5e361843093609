"""Measurements that are too long, or too much the machine's, for tests; each part has a ``main`` for ``ik_benchmark``.

Times are read from the clock here, and nowhere else below the node and the command lines.
"""
