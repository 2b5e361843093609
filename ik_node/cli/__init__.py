"""Command lines: one module per executable, with ``parser()`` and ``main(arguments)``.

``setup.py`` makes an executable of each ``main``; ``python -m ik_node.cli.NAME`` does the same. A module imports what
its task needs after the command line has been parsed, so that ``--help`` loads neither NumPy nor ROS. ``entry`` holds
what all of them share; ``ros_arguments`` separates options from arguments for ROS.
"""
