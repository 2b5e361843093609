"""Adds a tool that is not part of the URDF, as a link fixed to the tip."""

from __future__ import annotations

from math import atan2, sqrt
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from ik_node.errors import RobotError
from ik_node.math.se3 import pose_from
from ik_node.math.types import Array
from ik_node.robot.description import read_description


class DescriptionWithTool(NamedTuple):
    """A URDF with an added tool link."""

    urdf: str
    tip_frame: str
    """The new link: the tool point."""


def with_tool(urdf: str, tip_frame: str, offset: tuple[float, ...]) -> DescriptionWithTool:
    """Adds a link ``<tip_frame>_tool`` without mass and shape to a URDF.

    The tool is then part of recordings, replays and displays, which contain the URDF.

    Args:
        urdf: Text of the URDF.
        tip_frame: Link to which the tool is fixed.
        offset: Pose of the tool in ``tip_frame``: x, y, z [m], qx, qy, qz, qw.

    Returns:
        The URDF, and the name of the new link.

    Raises:
        RobotError: ``tip_frame`` is not a link, the name exists already, or ``offset`` does not have seven numbers.
        InputError: ``offset`` is not a pose.
    """
    if len(offset) != 7:
        raise RobotError(f"tool_offset has {len(offset)} numbers; expected 7: x y z qx qy qz qw")
    pose = pose_from(offset[:3], offset[3:], "tool_offset")
    description = read_description(urdf)
    links = description.masses
    name = f"{tip_frame}_tool"
    if tip_frame not in links:
        raise RobotError(f"tool_offset needs a link as tip_frame, not '{tip_frame}'; links: {', '.join(sorted(links))}")
    if name in links:
        raise RobotError(f"tool_offset adds a link '{name}', which exists already")
    xyz, rpy = (" ".join(repr(value) for value in values) for values in (pose[:3, 3].tolist(), _roll_pitch_yaw(pose)))
    addition = (
        f"<link name={quoteattr(name)}/>"
        f'<joint name={quoteattr(name + "_joint")} type="fixed">'
        f'<parent link={quoteattr(tip_frame)}/><child link={quoteattr(name)}/><origin xyz="{xyz}" rpy="{rpy}"/></joint>'
    )
    # The text as given keeps its comments; the checked text is for a root element with a prefix or a comment after it.
    text = urdf if urdf.rstrip().endswith("</robot>") else description.text
    before, closing, after = text.rpartition("</robot>")
    return DescriptionWithTool(f"{before}{addition}\n{closing}{after}", name)


def _roll_pitch_yaw(pose: Array) -> tuple[float, float, float]:
    """Angles with R = R_z(yaw) R_y(pitch) R_x(roll), as in URDF; at pitch +-90 degrees yaw is 0."""
    (r00, r01, _), (r10, r11, _), (r20, r21, r22) = pose[:3, :3].tolist()
    across = sqrt(r00 * r00 + r10 * r10)
    if across > 1e-9:
        return atan2(r21, r22), atan2(-r20, across), atan2(r10, r00)
    return (atan2(r01, r11) if r20 < 0.0 else atan2(-r01, r11)), atan2(-r20, across), 0.0
