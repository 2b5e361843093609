"""Names of methods: built-in ones, and own ones of the user by import path or entry point.

An own method is named by ``package.module:name``, or is an entry point of the group :data:`ENTRY_POINTS`.
"""

from __future__ import annotations

from importlib import metadata

from ik_node.errors import SettingsError
from ik_node.settings.schema import shown

METHOD_NAMES = ("plain", "inertia_weighted", "obstacle_gradient", "gravity_gradient", "joint_weighted")
"""Built-in values of ``method``. A new method is a name here and a function of that name in
:mod:`ik_node.differential_ik.methods`."""
ALL_METHODS = "all"
"""Value of ``--method`` of the command lines that stands for each of them."""
ENTRY_POINTS = "ik_node.methods"
"""Group of the entry points that are methods."""
OWN_NAMES = f"package.module:name, an entry point of the group {ENTRY_POINTS}, a name in extra_methods"
"""What is valid besides the built-in names."""


def is_import_path(name: str) -> bool:
    """True for ``package.module:name``."""
    module, colon, attribute = name.partition(":")
    return bool(colon) and all(part.isidentifier() for part in (*module.split("."), *attribute.split(".")))


def method_entry_points() -> dict[str, metadata.EntryPoint]:
    """Name -> entry point of the group."""
    return {entry.name: entry for entry in metadata.entry_points(group=ENTRY_POINTS)}


def check_method_names(method: str, extra: tuple[str, ...]) -> None:
    """Checks ``method`` and ``extra_methods``; nothing is imported.

    Raises:
        SettingsError: ``method`` is neither built in nor the name of an own method, or ``extra`` has an invalid name.
    """
    for name in extra:
        if name in METHOD_NAMES or not name.strip():
            reason = "is built in" if name in METHOD_NAMES else "is no name"
            raise SettingsError(f"extra_methods has '{name}', which {reason}; valid: {OWN_NAMES.rpartition(',')[0]}")
    known = method in (*METHOD_NAMES, *extra) or is_import_path(method)
    if not known and method not in method_entry_points():
        raise SettingsError(f"method is {shown(method)}; valid: {', '.join(METHOD_NAMES)}, {OWN_NAMES}")
