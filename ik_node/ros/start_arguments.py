"""Command-line arguments for ROS: parameters that ROS refuses for their spelling alone, and its own errors."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import rclpy
from rclpy.signals import SignalHandlerOptions

from ik_node.errors import SettingsError
from ik_node.settings.parameter_file import addresses, no_section_text, read_sections
from ik_node.settings.yaml_text import read_text, with_uniform_numbers

BEGIN, END = "--ros-args", "--"
FILE_OPTION = "--params-file"
PARAMETER_OPTIONS = ("-p", "--param")


def initialise(arguments: Sequence[str] | None) -> None:
    """Initialise rclpy without signal handlers, with arguments that its parser can read.

    ROS refuses lists such as [1, 2.5]; their whole numbers are written as doubles.

    Args:
        arguments: Arguments without the program's name; None takes those of the process.

    Raises:
        SettingsError: ROS cannot read the arguments; one line with its reason.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    with tempfile.TemporaryDirectory(prefix="ik_node_") as folder:
        try:
            rclpy.init(args=_readable(given, Path(folder)), signal_handler_options=SignalHandlerOptions.NO)
        except RuntimeError as error:
            raise SettingsError(_reason(error)) from error


def parameter_files(arguments: Sequence[str] | None) -> Iterator[Path]:
    """Yield the parameter files among the arguments."""
    for_ros, previous = False, ""
    for argument in sys.argv[1:] if arguments is None else arguments:
        for_ros = argument == BEGIN or (for_ros and argument != END)
        if for_ros and previous == FILE_OPTION:
            yield Path(argument)
        previous = argument


def unused_files(arguments: Sequence[str] | None, node: str) -> Iterator[str]:
    """Yield one line about each parameter file that has no parameters for ``node`` (full name)."""
    for path in parameter_files(arguments):
        try:
            sections = read_sections(path)
        except SettingsError:  # ROS has read the file; what it has read is checked elsewhere
            continue
        if not any(addresses(name, node) for name in sections):
            yield no_section_text(path, node, sections)


def _readable(arguments: Sequence[str], folder: Path) -> list[str]:
    """Return the arguments with uniform lists; files that have to be changed are copied into ``folder``."""
    readable: list[str] = []
    for_ros = False
    for index, argument in enumerate(arguments):
        for_ros = argument == BEGIN or (for_ros and argument != END)
        previous = readable[-1] if readable else ""
        if for_ros and previous in PARAMETER_OPTIONS and ":=" in argument:
            name, assign, value = argument.partition(":=")
            readable.append(f"{name}{assign}{with_uniform_numbers(value)}")
        elif for_ros and previous == FILE_OPTION and Path(argument).is_file():
            text = read_text(Path(argument))
            uniform = with_uniform_numbers(text)
            if uniform != text:
                copy = folder / f"{index}_{Path(argument).name}"
                copy.write_text(uniform)
                argument = str(copy)  # noqa: PLW2901
            readable.append(argument)
        else:
            readable.append(argument)
    return readable


def _reason(error: RuntimeError) -> str:
    """Return the reason of rcl without the places in its source files."""
    text = " ".join(str(error).split()).split(", at /", 1)[0]
    return f"arguments for ROS: {text.removeprefix('failed to initialize rcl: ')}"
