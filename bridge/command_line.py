"""The command line: parse the arguments, set up the log, run the command."""

from __future__ import annotations

import logging
import sys
import warnings
from dataclasses import replace
from typing import Any

from phy124.errors import InputError
from phy124.runtime.failures import Kind, failure
from phy124.schema.arguments.parsing import Answered, parse

from . import PROGRAM
from .commands import COMMANDS, Play, Steer

MAY_BE_EMPTY = ("--parent-frame",)


def run(arguments: list[str], description: str | None) -> int:
    """Run a command; return the exit status."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", force=True)
    with warnings.catch_warnings():
        warnings.showwarning = _note
        try:
            return _command(arguments, description).run(_say)
        except Answered:
            raise
        except BaseException as problem:
            return _report(problem)


def _command(arguments: list[str], description: str | None) -> Any:
    program, ros = split_ros_arguments(arguments)
    command = parse(program, COMMANDS, program=PROGRAM, description=description, empty=MAY_BE_EMPTY)
    if not ros:
        return command
    if not isinstance(command, (Play, Steer)):
        limit = "Only `play` and `live` take arguments for ROS 2."
        raise InputError("--ros-args", " ".join(ros[1:]), limit, "Remove them.")
    return replace(command, ros_args=tuple(ros))


def split_ros_arguments(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Separate ROS arguments (from `--ros-args` up to `--` or the end) from the other arguments.

    The other arguments are returned first. After a `--` outside ROS arguments, all arguments are
    ordinary, even `--ros-args`.
    """
    program: list[str] = []
    ros: list[str] = []
    target = program
    for place, argument in enumerate(arguments):
        if argument == "--" and target is program:
            program += arguments[place:]
            break
        if argument == "--ros-args":
            target = ros
        elif argument == "--" and target is ros:
            target = program
            ros.append(argument)
            continue
        target.append(argument)
    return program, ros


def _report(problem: BaseException) -> int:
    ending = failure(problem)
    text = "stopped" if ending.kind is Kind.STOPPED else ending.sentence
    print(f"bridge: {text}", file=sys.stderr)
    return ending.status


def _say(line: str) -> None:
    print(line, flush=True)


def _note(message: Warning | str, *_: object) -> None:
    """Log a warning without the line of source code that caused it."""
    logging.getLogger(__name__).warning(str(message))
