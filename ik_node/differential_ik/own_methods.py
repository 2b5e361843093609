"""Own methods: weight and gradient from a function of the user.

The function takes the robot and joint positions, and returns W, grad_h and, if it has one, the potential h::

    def centre(robot, q):
        return None, q - MIDDLE, 0.5 * (q - MIDDLE) @ (q - MIDDLE)      # W or None, grad_h or None, h

It has to be a function of its arguments alone: a replay calls it again. :func:`load_methods` finds it by import path or
entry point, and checks it at :data:`CHECKED_POSITIONS` positions: its signature, shapes, finite numbers, W symmetric
positive definite, and grad_h against central differences of h. Every call checks the same, except the gradient; a call
that fails is a :class:`MethodFault`, and :class:`ik_node.differential_ik.selected_method.SelectedMethod` continues with
``plain``.
"""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ik_node.differential_ik.methods import METHODS, joint_without_weight
from ik_node.errors import MethodFault, SettingsError
from ik_node.math.numerics import low_discrepancy_points
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.robot.screw_chain import finite_range
from ik_node.settings.groups import ControlSettings, Settings
from ik_node.settings.method_names import is_import_path, method_entry_points

MethodFunction = Callable[[Robot, Array], Any]
"""(robot, q (n,)) -> W (n, n) or None, grad_h (n,) or None, and optionally h."""

CHECKED_POSITIONS = 8
"""Number of positions in the joint range at which a function is checked."""
STEP = 1e-5
"""Step of the central differences of h, rad (m)."""
MAX_GRADIENT_ERROR = 1e-3
"""Largest error of grad_h, relative to its largest component at the checked positions."""
ASYMMETRY = 1e-9
"""Largest asymmetry of W, relative to its largest element."""
LEAST, LARGEST = 1e-9, 1e9
"""Range of the diagonal of W, and largest component of grad_h; beyond it products are no longer exact."""


class OwnCost(NamedTuple):
    """What a function returned, checked; see :class:`ik_node.differential_ik.methods.MethodCost`."""

    weight: Array | None
    gradient: Array | None
    potential: float | None
    """h, J; None if the function does not return it."""


class OwnMethod(NamedTuple):
    """A method of the user."""

    name: str
    function: MethodFunction
    digest: str = ""
    """16 hexadecimal digits of the file that defines the function; empty where there is none."""

    def cost(self, robot: Robot, q: Array) -> OwnCost:
        """Cost at q (n,); ``robot`` should be a copy that only the function uses.

        Raises:
            MethodFault: The function raised an exception, or its result is not valid; names the fault.
        """
        try:
            return _checked(self.function(robot, q.copy()), robot)
        except MethodFault as fault:
            raise MethodFault(f"method '{self.name}': {fault}") from fault
        except (Exception, SystemExit) as error:  # whatever an unknown function raises
            raise MethodFault(f"method '{self.name}' raised {type(error).__name__}: {error}") from error


GivenMethods = Mapping[str, MethodFunction | OwnMethod]
"""Name -> function of an own method."""


def with_method_listed(settings: Settings) -> Settings:
    """Settings whose ``extra_methods`` has ``method`` if that is not built in.

    A recording can then be read where the entry point is not installed.
    """
    control = settings.control
    if control.method in METHODS or control.method in control.extra_methods:
        return settings
    extra = (*control.extra_methods, control.method)
    return dataclasses.replace(settings, control=dataclasses.replace(control, extra_methods=extra))


def load_methods(robot: Robot, control: ControlSettings, given: GivenMethods | None = None) -> dict[str, OwnMethod]:
    """Loads and checks the own methods that the settings name.

    Args:
        robot: The arm.
        control: ``method`` and ``extra_methods``.
        given: Functions by name, which are not imported; those of type :class:`OwnMethod` are not checked again.

    Returns:
        Name -> method.

    Raises:
        SettingsError: A function cannot be imported, or does not pass a check; names it and the reason.
    """
    names = dict.fromkeys((*control.extra_methods, *(name for name in (control.method,) if name not in METHODS)))
    methods, own_robot = {}, robot.copy()
    for name in names:
        known = None if given is None else given.get(name)
        if isinstance(known, OwnMethod):
            methods[name] = known
            continue
        function = _imported(name) if known is None else known
        methods[name] = OwnMethod(name, function, source_digest(function))
        check_own_method(methods[name], own_robot)
    return methods


def _imported(name: str) -> MethodFunction:
    try:
        if not is_import_path(name):
            found: Any = method_entry_points()[name].load()
        else:
            module, _, attribute = name.partition(":")
            found = import_module(module)
            for part in attribute.split("."):
                found = getattr(found, part)
    except KeyError:
        known = ", ".join(method_entry_points()) or "none is installed"
        raise SettingsError(f"method '{name}' is no entry point of the group ik_node.methods; valid: {known}") from None
    except (Exception, SystemExit) as error:  # whatever the user's module raises
        reason = str(error) if isinstance(error, (ImportError, AttributeError)) else f"{type(error).__name__}: {error}"
        raise SettingsError(f"method '{name}' cannot be imported: {reason}") from error
    if not callable(found):
        raise SettingsError(f"method '{name}' is a {type(found).__name__}; expected a function of (robot, q)")
    return found  # type: ignore[no-any-return]


def source_digest(function: MethodFunction) -> str:
    """Digest of the file that defines ``function``, else of its byte code; empty if there is neither."""
    module = sys.modules.get(getattr(function, "__module__", None) or type(function).__module__)
    path = getattr(module, "__file__", None)
    if path is not None and Path(path).is_file():
        data = Path(path).read_bytes()
    else:
        data = getattr(getattr(function, "__code__", None), "co_code", b"")
    return hashlib.sha256(data).hexdigest()[:16] if data else ""


def check_own_method(method: OwnMethod, robot: Robot) -> None:
    """Checks signature and results of a method, and its gradient where it returns h.

    Args:
        method: The method.
        robot: A copy that only the function uses.

    Raises:
        SettingsError: A check fails; names the method, what is wrong, and what is expected.
    """
    try:
        inspect.signature(method.function).bind(robot, np.zeros(robot.n))
    except TypeError as error:
        raise SettingsError(f"method '{method.name}' does not take (robot, q): {error}") from error
    except ValueError:  # a function in C without a signature
        pass
    low, high = finite_range(robot)
    positions = low + (high - low) * low_discrepancy_points(np.arange(CHECKED_POSITIONS), robot.n)
    try:
        costs = [method.cost(robot, q) for q in positions]
        if all(cost.potential is None for cost in costs):
            return
        slopes = np.array([_slope(method, robot, q) for q in positions])
    except MethodFault as fault:
        raise SettingsError(f"{fault}; checked at the start, at {CHECKED_POSITIONS} joint positions") from fault
    gradients = np.array([np.zeros(robot.n) if cost.gradient is None else cost.gradient for cost in costs])
    values = np.array([np.nan if cost.potential is None else cost.potential for cost in costs])
    rounding = np.finfo(np.float64).eps * np.abs(values).max() / STEP
    excess = np.abs(gradients - slopes) - MAX_GRADIENT_ERROR * np.abs(slopes).max() - rounding
    if not (excess <= 0.0).all():
        row, joint = np.unravel_index(int(np.nan_to_num(excess, nan=np.inf).argmax()), excess.shape)
        raise SettingsError(
            f"method '{method.name}': its gradient is not that of its h at {_text(positions[row])}: "
            f"{gradients[row, joint]:.6g} for joint '{robot.joints[joint]}', differences of h give "
            f"{slopes[row, joint]:.6g}"
        )


def _slope(method: OwnMethod, robot: Robot, q: Array) -> Array:
    """Central differences of h, (n,); NaN where there is no h."""
    slope = np.empty(robot.n)
    for joint in range(robot.n):
        step = np.zeros(robot.n)
        step[joint] = STEP
        above, below = (method.cost(robot, q + side * step).potential for side in (1.0, -1.0))
        slope[joint] = np.nan if above is None or below is None else (above - below) / (2.0 * STEP)
    return slope


def _checked(result: Any, robot: Robot) -> OwnCost:
    """The cost in the result of a function; raises MethodFault naming what is wrong."""
    if not isinstance(result, (tuple, list)) or len(result) not in (2, 3):
        raise MethodFault(f"it returned {_kind(result)}; expected W, grad_h and optionally h")
    given_weight, given_gradient, *rest = result
    n = robot.n
    weight = gradient = None
    if given_weight is not None:
        weight = _array(given_weight, (n, n), "W")
        size = np.abs(weight).max()
        if np.abs(weight - weight.T).max() > ASYMMETRY * size:
            raise MethodFault("W is not symmetric")
        weight = 0.5 * (weight + weight.T)
        diagonal = np.diagonal(weight)
        joint = joint_without_weight(weight) if diagonal.min() > 0.0 else int(diagonal.argmin())
        if joint is not None:
            raise MethodFault(f"W is not positive definite (joint '{robot.joints[joint]}')")
        if diagonal.min() < LEAST or diagonal.max() > LARGEST:
            raise MethodFault(f"the diagonal of W is {_text(diagonal)}; valid: {LEAST:g} to {LARGEST:g}")
    if given_gradient is not None:
        gradient = _array(given_gradient, (n,), "grad_h")
        if np.abs(gradient).max() > LARGEST:
            raise MethodFault(f"grad_h is {_text(gradient)}; valid: up to {LARGEST:g}")
    potential = None if not rest or rest[0] is None else float(_array(rest[0], (), "h"))
    return OwnCost(weight, gradient, potential)


def _array(value: Any, shape: tuple[int, ...], name: str) -> Array:
    try:
        array = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError) as error:
        raise MethodFault(f"{name} is {_kind(value)}; expected numbers {_shape_text(shape)}") from error
    if array.shape != shape:
        raise MethodFault(f"{name} has the shape {_shape_text(array.shape)}; expected {_shape_text(shape)}")
    if not np.isfinite(array).all():
        raise MethodFault(f"{name} is not finite")
    return array


def _kind(value: Any) -> str:
    size = f" of {len(value)}" if isinstance(value, (tuple, list, dict, str)) else ""
    return f"{type(value).__name__}{size}"


def _shape_text(shape: tuple[int, ...]) -> str:
    return str(shape) if shape else "()"


def _text(values: Array) -> str:
    return f"[{', '.join(f'{value:.4g}' for value in values)}]"
