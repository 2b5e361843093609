"""Nobody who runs these tests meets another in a ROS domain."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

from domains import DOMAINS, free_domain, own_domain
from support import PROJECT

HOLDER = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from domains import own_domain
with own_domain(Path(sys.argv[2])) as domain:
    print(domain, flush=True)
    sys.stdin.read()
"""


def test_every_domain_has_one_owner_at_a_time(tmp_path: Path) -> None:
    with ExitStack() as stack:
        owned = [stack.enter_context(own_domain(tmp_path)) for _ in DOMAINS]
        assert sorted(owned) == list(DOMAINS)
        assert free_domain(tmp_path) is None
    with own_domain(tmp_path) as again:
        assert again in DOMAINS


def test_processes_are_kept_apart_and_the_dead_own_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLDER, str(PROJECT / "test"), str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        theirs = int(other.stdout.readline())
        with ExitStack() as stack:
            ours = {stack.enter_context(own_domain(tmp_path)) for _ in range(len(DOMAINS) - 1)}
            assert ours == set(DOMAINS) - {theirs}
            assert free_domain(tmp_path) is None
            other.kill()
            other.wait()
            found = free_domain(tmp_path)
            assert found is not None
            assert found[0] == theirs
            os.close(found[1])
