"""The command line: `python -m bridge record|play|info|recover|doctor ...`.

Exit status: 0 done, 1 the machine refused, 2 bad input, 3 the simulation stopped early and kept
its good frames, 130 interrupted. No traceback for what a user can mend.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    import tyro
    from pydantic import ValidationError

    from phy124.errors import InputError

    from .commands import COMMANDS

    logging.basicConfig(level=logging.INFO, format="%(message)s", force=True)
    # A supervisor's SIGTERM must end a recording as cleanly as Ctrl-C does.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        command = tyro.extras.subcommand_cli_from_dict(
            COMMANDS, prog="python -m bridge", description=__doc__, args=arguments
        )
        return command.run(_say)
    except InputError as error:
        return _complain(str(error), 2)
    except ValidationError as error:
        return _complain("; ".join(_sentence(found) for found in error.errors()), 2)
    except KeyboardInterrupt:
        return _complain("stopped", 130)
    except BrokenPipeError:
        # `... | head` has read enough; nothing may be written when Python ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        return _complain(f"the machine refused: {error}", 1)


def _say(line: str) -> None:
    print(line, flush=True)


def _sentence(found: object) -> str:
    assert isinstance(found, dict)
    where = ".".join(str(part) for part in found["loc"]) or "options"
    return f"{where} = {found['input']}: {found['msg'].removeprefix('Value error, ')}"


def _complain(sentence: str, status: int) -> int:
    print(f"bridge: {sentence}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
