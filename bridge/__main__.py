"""The bridge: record, play, inspect and repair moving Gaussians as ROS 2 messages.

Exit status: 0 if the command succeeded, 1 if the machine failed, 2 if an input is invalid, 3 if the
simulation stopped early and its valid frames were saved, 130 if interrupted. Errors that a user can
correct show no traceback.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

STOPPED = "bridge: stopped\n"
ALWAYS = ("SIGINT",)
"""Signals that end a node even if the parent process set them to be ignored; `ros2 launch` sends
SIGINT.
"""


# Only light modules are imported above, because Ctrl-C shows a traceback until `importing` runs.
@contextmanager
def importing(status: int, text: str = "") -> Iterator[None]:
    """Within this context, let Ctrl-C and SIGTERM end the process with a status and a message.

    A KeyboardInterrupt could be lost, because some libraries catch it while they are imported.
    """
    try:
        from phy124.runtime.signals import ending, handling

        with handling(ending(status, text), always=ALWAYS):
            yield
    except KeyboardInterrupt:
        sys.stderr.write(text)
        raise SystemExit(status) from None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return the exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        with importing(130, STOPPED):
            from phy124.runtime.failures import failure
            from phy124.runtime.memory import refuse_narrow
            from phy124.runtime.signals import handling, interrupt
            from phy124.runtime.streams import steady_streams

            refuse_narrow()  # this must precede the import of NumPy
            from .command_line import run
        with steady_streams() as lost, handling(interrupt, always=ALWAYS):
            status = run(words, __doc__)
            sys.stdout.flush()
            if lost:
                print(f"bridge: {failure(lost[0]).sentence}", file=sys.stderr)
            return 1 if lost else status
    except KeyboardInterrupt:
        sys.stderr.write(STOPPED)
        return 130
    except (MemoryError, ValueError) as problem:
        from phy124.runtime.failures import failure

        cause = failure(problem)
        print(f"bridge: {cause.sentence}", file=sys.stderr)
        return cause.status


if __name__ == "__main__":
    sys.exit(main())
