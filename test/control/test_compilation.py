"""The compilation by several processes: what they leave to the process that waits for them."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
from ik_node.control.compilation import sample_arm
from ik_node.control.warm_up import warm_up
from ik_node.jit import compilation_count
from ik_node.robot.catalogue import load_robot
from ik_node.settings.groups import Settings

warm_up(sample_arm(), Settings())
before = compilation_count()
warm_up(load_robot("panda"), Settings())
print(before, compilation_count() - before)
"""


def test_the_arm_of_the_processes_needs_every_function_that_a_real_one_needs() -> None:
    """In a process of its own, because functions compiled by another test would hide missing ones."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    called, left = map(int, done.stdout.split())
    assert called > 0
    assert left == 0
