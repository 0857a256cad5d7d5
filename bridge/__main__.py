"""The command line: `python -m bridge record|play|info|recover|doctor ...`.

Exit status: 0 done, 1 the machine refused, 2 bad input, 3 the simulation stopped early and kept
its good frames, 130 interrupted. No traceback for what a user can mend.
"""

from __future__ import annotations

# Everything else is imported inside `main`, so that Ctrl-C is heard from the first moment on.
import os
import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    try:
        return _run(list(sys.argv[1:] if arguments is None else arguments))
    except KeyboardInterrupt:
        return _complain("stopped", 130)
    except BrokenPipeError:
        # `... | head` has read enough; nothing may be written when Python ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        return _complain(f"the machine refused: {error}", 1)


def _run(arguments: list[str]) -> int:
    import logging
    import signal
    from dataclasses import replace

    import tyro
    from pydantic import ValidationError

    from phy124.errors import InputError
    from phy124.repeats import gathered

    from .commands import COMMANDS, Play
    from .options import Options

    logging.basicConfig(level=logging.INFO, format="%(message)s", force=True)
    # A supervisor's SIGTERM must end a recording as cleanly as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    own, ros = split_ros_arguments(arguments)
    try:
        command = tyro.extras.subcommand_cli_from_dict(
            COMMANDS, prog="python -m bridge", description=__doc__, args=gathered(own, COMMANDS)
        )
        if ros:
            if not isinstance(command, Play):
                limit = "Only `play` takes arguments for ROS 2."
                raise InputError("--ros-args", " ".join(ros[1:]), limit, "Leave them out.")
            command = replace(command, ros_args=tuple(ros))
        return command.run(_say)
    except InputError as error:
        return _complain(str(error), 2)
    except ValidationError as error:
        from phy124.scene.refusals import refusal

        return _complain(str(refusal(error, "options", Options)), 2)


def split_ros_arguments(arguments: list[str]) -> tuple[list[str], list[str]]:
    """The arguments of the program, and those between `--ros-args` and `--` or the end."""
    own: list[str] = []
    ros: list[str] = []
    target = own
    for argument in arguments:
        if argument == "--ros-args":
            target = ros
        elif argument == "--" and target is ros:
            target = own
            ros.append(argument)
            continue
        target.append(argument)
    return own, ros


def _say(line: str) -> None:
    print(line, flush=True)


def _complain(sentence: str, status: int) -> int:
    print(f"bridge: {sentence}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
