"""Read a recording of the node into arrays: one row per control step."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import ik_node

BAG = Path(__file__).resolve().parent.parent / "bags" / "limit"


def main(bag: str = str(BAG)) -> None:
    """Print what the recording ``bag`` holds."""
    run = ik_node.load_run(bag)
    print(f"{len(run.tick)} control steps of {run.robot} in {run.times_s[-1]:.2f} s, joints: {', '.join(run.joints)}")
    for name in ("q", "joint_velocity", "pose_sb", "error_b", "singular_values"):
        print(f"{name:16} {getattr(run, name).shape}")
    with np.errstate(invalid="ignore"):
        position_error = np.linalg.norm(run.error_b[:, :3], axis=1)
    print(f"RMS position error {1e3 * np.sqrt(np.nanmean(position_error**2)):.3f} mm")
    limited = {name for names in run.binding for name in names}
    print(f"active limits: {', '.join(sorted(limited)) or 'none'}")
    for change in run.status_changes:
        print(f"{change.time_s:7.3f} s  {change.status.mode.value:9} {change.status.reason}")


if __name__ == "__main__":
    main(*sys.argv[1:])
