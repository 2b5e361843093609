"""YAML of parameters, read as the parser of ROS reads it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from ik_node.errors import InputError, SettingsError

MAX_BYTES = 1_000_000
"""Largest parameter file: a hundred times that of all parameters with their descriptions. A larger file is no parameter
file, and takes seconds to parse."""
MAX_DEPTH = 50
"""Deepest nesting; parameters, scenes and metadata of bags have less than 10, and the parser recurses."""
_FLOAT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_INTEGER = re.compile(r"[-+]?\d+")

_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""In C, which takes a fifth of the time, where PyYAML was built with libyaml."""


class _Loader(_SafeLoader):  # type: ignore[misc]  # its base is known at run time
    """Takes 1e3 for a number, as ROS does and YAML 1.1 does not."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def load_yaml(text: str) -> Any:
    """The content of a YAML document; every YAML of this package is read here.

    Raises:
        InputError: The text is not YAML, is too large or nested too deeply, or has an alias. ROS refuses aliases, and a
            few lines of them expand to more than any memory.
    """
    if len(text) > MAX_BYTES:
        raise InputError(f"{len(text)} characters of YAML; at most {MAX_BYTES} are read")
    try:
        depth = 0
        for event in yaml.parse(text, Loader=_SafeLoader):  # does not recurse
            if isinstance(event, yaml.AliasEvent):
                raise InputError("aliases (*name) are not accepted in YAML")
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                raise InputError(f"YAML is nested more than {MAX_DEPTH} deep")
        return yaml.load(text, Loader=_Loader)
    except InputError:
        raise
    # Constructors of PyYAML raise any of these for values such as `!!int ''`, `!!bool x` or `2001-99-99`.
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, ArithmeticError, LookupError) as error:
        raise InputError(f"not YAML: {' '.join(str(error).split())}") from error


def bounded_text(path: Path) -> str:
    """The text of a YAML file, which may also be a pipe; of a device no more is read than of a file.

    Raises:
        InputError: The file is too large or is no text.
        OSError: The file cannot be read.
    """
    with path.open("rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise InputError(f"more than {MAX_BYTES} bytes")
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise InputError(f"no text: {error}") from error


def read_text(path: Path) -> str:
    """The text of a parameter file; raises SettingsError when it cannot be read or is too large."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise SettingsError(f"'{path}' has {path.stat().st_size} bytes; a parameter file has at most {MAX_BYTES}")
        return bounded_text(path)
    except SettingsError:
        raise
    except (OSError, InputError, ValueError) as error:
        raise SettingsError(f"'{path}' is no parameter file: {error}") from error


def with_uniform_numbers(text: str) -> str:
    """YAML in which lists that mix whole numbers and doubles, such as [1, 2.5], have doubles only.

    ROS refuses to parse mixed lists.

    Args:
        text: YAML text.

    Returns:
        The text with ".0" after each whole number in such a list; unchanged if it is not YAML.
    """
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        ends = sorted(_whole_numbers_in_mixed_lists(root), reverse=True)
    except (yaml.YAMLError, RecursionError):
        return text
    for end in ends:
        text = f"{text[:end]}.0{text[end:]}"
    return text


def _whole_numbers_in_mixed_lists(root: Any) -> Iterator[int]:
    """Yield where the text of each whole number ends."""
    todo, seen = [root], set()
    while todo:
        node = todo.pop()
        if node is None or id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, yaml.MappingNode):
            todo += [value for _, value in node.value]
        elif isinstance(node, yaml.SequenceNode):
            todo += node.value
            plain = [entry for entry in node.value if isinstance(entry, yaml.ScalarNode) and entry.style is None]
            whole = [entry for entry in plain if _INTEGER.fullmatch(entry.value)]
            is_number = [_FLOAT.fullmatch(entry.value) or entry.tag.endswith(":float") for entry in plain]
            if len(plain) == len(node.value) and all(is_number) and 0 < len(whole) < len(plain):
                yield from (entry.end_mark.index for entry in whole)
