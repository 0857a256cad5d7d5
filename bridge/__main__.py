"""The bridge: record, play, inspect and repair moving Gaussians as ROS 2 messages.

Exit status: 0 done, 1 the machine refused, 2 bad input, 3 the simulation stopped early and kept
its good frames, 130 interrupted. Errors that a user can correct show no traceback.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

# `importing` explains what must not be imported here.
STOPPED = "bridge: stopped\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        from .importing import importing

        with importing(130, STOPPED):
            from phy124.runtime.signals import handled, interrupt

            from .command_line import run
        with handled(interrupt):
            return run(given, __doc__)
    except (KeyboardInterrupt, SystemError) as error:
        # Ctrl-C while a library's native code calls Python arrives as the cause of a SystemError.
        if not isinstance(error.__cause__ or error, KeyboardInterrupt):
            raise
        sys.stderr.write(STOPPED)
        return 130
    except BrokenPipeError:
        # As in `... | head`: the reader has closed the pipe, and nothing may be written at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        sys.stderr.write(f"bridge: the machine refused: {error}\n")
        return 1


if __name__ == "__main__":
    sys.exit(main())
