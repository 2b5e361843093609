"""Pinocchio model of a URDF, reduced to the controlled joints and their mimic joints."""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from ik_node.errors import RobotError, UnknownNameError
from ik_node.math.types import Array
from ik_node.robot.description import Description
from ik_node.robot.mimic import Mimic

_stderr_lock = threading.Lock()


def read(description: Description) -> Any:
    """Complete model of a description; raises RobotError with the reasons of urdfdom and Pinocchio when it is invalid.

    urdfdom gives its reasons on the standard error output only.
    """
    printed: list[str] = []
    try:
        with _stderr_captured(printed):
            model = pin.buildModelFromXML(description.text)
    except Exception as error:  # whatever C++ raises
        lines = [line.strip() for line in printed]
        reasons = [line.removeprefix("Error:").strip() for line in lines if line.startswith("Error:")]
        reason = "; ".join(reasons or [" ".join(str(error).split())])
        raise RobotError(f"robot_description is not a valid URDF: {reason}") from error
    if printed:
        os.write(2, "".join(printed).encode())
    for frame in model.frames:
        if not np.isfinite(frame.placement.homogeneous).all():
            raise RobotError(f"robot_description is not a valid URDF: the pose of '{frame.name}' is not finite")
    return model


@contextlib.contextmanager
def _stderr_captured(printed: list[str]) -> Iterator[None]:
    """Appends to ``printed`` the lines that are written to the standard error output, by C++ too."""
    with _stderr_lock, contextlib.ExitStack() as stack:
        try:
            usual = os.dup(2)
        except OSError:  # the process has no standard error output
            yield
            return
        stack.callback(os.close, usual)
        file = stack.enter_context(tempfile.TemporaryFile())
        os.dup2(file.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(usual, 2)
            file.seek(0)
            printed.extend(file.read().decode(errors="replace").splitlines(keepends=True))


def held_at(full: Any, mimics: Mapping[str, Mimic]) -> Array:
    """Neutral configuration, with mimic joints at their offset."""
    configuration: Array = pin.neutral(full)
    for name, mimic in mimics.items():
        if full.existJointName(name):
            joint = full.joints[full.getJointId(name)]
            if joint.nv != 1:
                raise RobotError(f"joint '{name}' has {joint.nv} degrees of freedom; only joints with one can mimic")
            value = [np.cos(mimic.offset), np.sin(mimic.offset)] if joint.nq == 2 else mimic.offset
            configuration[joint.idx_q : joint.idx_q + joint.nq] = value
    return configuration


def reduced(full: Any, held: list[int], configuration: Array) -> Any:
    """``full`` with the joints ``held`` fixed at ``configuration``.

    buildReducedModel finds frames by name only and fails when a joint and a link have the same name (so100, anymal);
    therefore such joints are renamed temporarily.
    """
    count = Counter(frame.name for frame in full.frames)
    _rename_joints(full, {name: f"{name} (joint)" for name in count if count[name] > 1})
    try:
        reduced = pin.buildReducedModel(full, held, configuration)
    except Exception as error:  # whatever C++ raises
        raise RobotError(f"the joints that are not controlled cannot be fixed: {error}") from error
    _rename_joints(reduced, {f"{name} (joint)": name for name in count if count[name] > 1})
    return reduced


def _rename_joints(model: Any, names: dict[str, str]) -> None:
    for index in range(1, model.njoints):
        model.names[index] = names.get(model.names[index], model.names[index])
    for frame in model.frames:
        if frame.type in (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT):
            frame.name = names.get(frame.name, frame.name)


def root_frame(model: Any) -> str:
    """Name of the first link."""
    return str(next(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY))


def frame_id(model: Any, name: str) -> int:
    """Index of a frame, links before fixed joints; raises UnknownNameError listing the frames."""
    kinds = (pin.FrameType.BODY, pin.FrameType.FIXED_JOINT, pin.FrameType.OP_FRAME)
    for kind in kinds:
        if model.existFrame(name, kind):
            return int(model.getFrameId(name, kind))
    names = {frame.name for frame in model.frames if frame.type in kinds} - {"universe"}
    raise UnknownNameError("frame", name, names)


def select(model: Any, base: str, tip: str, requested: tuple[str, ...], mimics: Mapping[str, Mimic]) -> tuple[str, ...]:
    """Names of the controlled joints; raises RobotError or UnknownNameError naming what cannot be controlled."""
    base_joint = model.frames[frame_id(model, base)].parentJoint
    tip_joint = model.frames[frame_id(model, tip)].parentJoint
    base_chain, tip_chain = list(model.supports[base_joint]), list(model.supports[tip_joint])
    chain = [index for index in tip_chain if index not in base_chain]
    below_base = [model.names[index] for index in base_chain if index not in tip_chain]
    if below_base:
        moving = ", ".join(below_base)
        text = f"base frame '{base}' is not between the root and tip frame '{tip}': joints {moving} move it"
        raise RobotError(text if chain else f"{text}; exchange base frame and tip frame")
    movable = {model.names[index]: index for index in range(1, model.njoints)}
    for name in requested:
        if name not in movable:
            raise UnknownNameError("joint", name, movable)
        if name in mimics:
            master = mimics[name].master
            raise RobotError(f"joint '{name}' mimics '{master}' and cannot be controlled by itself; control '{master}'")
    if len(set(requested)) != len(requested):
        raise RobotError(f"joints contains a name twice: {', '.join(requested)}")
    movers = _moving(model, [model.names[index] for index in chain], mimics)
    selected = requested or movers
    if not selected:
        raise RobotError(f"no movable joint between base frame '{base}' and tip frame '{tip}'")
    for name in selected:
        joint = model.joints[movable[name]]
        if joint.nv != 1:
            raise RobotError(
                f"joint '{name}' has {joint.nv} degrees of freedom; only joints with one can be controlled"
            )
        if name not in movers:
            moving = ", ".join(movers)
            raise RobotError(f"joint '{name}' does not move tip frame '{tip}'; valid: {moving}")
    return selected


def _moving(model: Any, chain: list[str], mimics: Mapping[str, Mimic]) -> tuple[str, ...]:
    """``chain`` with mimic joints replaced by their masters, without joints that the URDF fixes."""
    masters: dict[str, None] = {}
    for name in chain:
        master = mimics[name].master if name in mimics else name
        if not model.existFrame(master):
            raise RobotError(f"joint '{name}' mimics '{master}', which does not exist")
        if model.existJointName(master):
            masters[master] = None
    return tuple(masters)


def strip(name: str, prefix: str) -> str:
    """``name`` without ``prefix``."""
    return name[len(prefix) :] if prefix and name.startswith(prefix) else name
