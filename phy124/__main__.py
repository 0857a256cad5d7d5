"""The command line: `phy124 COMMAND ...`, or `python -m phy124`.

Exit status: 0 done, 1 the machine refused (disk full, ...), 2 bad input, 3 the simulation stopped
early and kept its good frames, 130 interrupted. No traceback for what a user can mend.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    import tyro
    import warp as wp

    from phy124.commands import COMMANDS
    from phy124.errors import Cancelled, InputError
    from phy124.repeats import gathered
    from phy124.signals import handled, interrupt

    wp.config.log_level = wp.LOG_ERROR
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    try:
        command = tyro.extras.subcommand_cli_from_dict(
            COMMANDS, prog="phy124", description=__doc__, args=gathered(arguments, COMMANDS)
        )
        with handled(interrupt):
            return command.run()
    except InputError as error:
        _complain(str(error), as_json="--json" in arguments)
        return 2
    except (KeyboardInterrupt, Cancelled):
        _complain("stopped; nothing half-written was left behind", as_json="--json" in arguments)
        return 130
    except OSError as error:
        _complain(f"the machine refused: {error}", as_json="--json" in arguments)
        return 1


def _complain(sentence: str, *, as_json: bool) -> None:
    """One sentence, no traceback; as JSON on standard output for scripts."""
    if as_json:
        print(json.dumps({"error": sentence}))
    print(f"phy124: {sentence}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
