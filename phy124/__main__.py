"""The command line: `phy124 COMMAND ...`, or `python -m phy124`.

Every command also accepts --quiet (print only problems) and --verbose (print the messages of the
libraries, and the traceback of an error). `phy124 --version` prints the version. `phy124
--tyro-print-completion bash` (zsh, fish) prints a script that completes commands and options with
the Tab key; see docs/guide/commands.md.

Exit status: 0 if the command succeeded, 1 if the machine failed (disk full, ...), 2 if an input is
invalid, 3 if the simulation stopped early and its valid frames were saved, 130 if interrupted.
Errors that a user can correct show no traceback.
"""

from phy124.runtime.signals import ending, handling, interrupt

with handling(ending(130, "phy124: stopped\n")):  # an error message instead of a traceback
    import atexit
    import json
    import os
    import sys
    import threading
    import traceback
    import warnings
    from collections.abc import Sequence
    from contextlib import ExitStack, redirect_stdout, suppress
    from functools import partial
    from typing import Any, NoReturn

    from phy124 import __version__
    from phy124.runtime.failures import failure
    from phy124.runtime.late_builtins import declare_late
    from phy124.runtime.light_imports import import_lightly
    from phy124.runtime.memory import pause_collection, refuse_narrow, share_heap
    from phy124.runtime.streams import steady_streams
    from phy124.schema.arguments.parsing import Answered
    from phy124.schema.arguments.words import split_operands

GENERAL = ("--quiet", "--verbose")
"""Options that every command accepts."""


def program() -> NoReturn:
    """Run the command of this process and end the process without Python's usual clean-up.

    Python would free each object separately, which takes 0.1 s after a run.
    """
    status = main()  # flushes the standard streams
    threading._shutdown()  # pyright: ignore[reportAttributeAccessIssue] # waits for all threads
    atexit._run_exitfuncs()
    os._exit(status)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command, and return the exit status of the process."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    options, operands = split_operands(arguments)
    chosen = {name for name in GENERAL if name in options}
    rest = [*(text for text in options if text not in GENERAL), *operands]
    report = partial(_report, as_json="--json" in options, verbose="--verbose" in chosen)
    with steady_streams() as lost:
        try:
            with handling(interrupt):
                status = _run(rest, quiet="--quiet" in chosen, verbose="--verbose" in chosen)
        except Answered:
            sys.stdout.flush()
            if not lost:
                raise
            status = 1
        except BaseException as problem:
            status = report(problem)
        sys.stdout.flush()
        return report(lost[0]) if lost else status


def _run(arguments: list[str], *, quiet: bool, verbose: bool) -> int:
    if arguments == ["--version"]:
        print(f"phy124 {__version__}")
        return 0
    with ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        warnings.showwarning = _note
        with pause_collection():
            command = _parse(arguments)
        if "warp" in sys.modules:  # Some commands, such as `weights`, do not need Warp.
            _start(talkative=verbose and "--json" not in split_operands(arguments)[0])
        if quiet:
            from phy124.commands.bars import silence

            stack.enter_context(silence())
            nowhere = stack.enter_context(open(os.devnull, "w", encoding="utf-8", errors="replace"))
            stack.enter_context(redirect_stdout(nowhere))
        return command.run()


def _start(*, talkative: bool) -> None:
    import warp as wp

    from phy124.runtime.startup import start

    start()
    wp.config.log_level = wp.LOG_INFO if talkative else wp.LOG_ERROR


def _parse(arguments: list[str]) -> Any:
    from phy124.commands import COMMANDS, outline
    from phy124.schema.arguments.parsing import asks_for_commands, parse

    if asks_for_commands(arguments):
        commands = outline()
    else:
        share_heap()
        refuse_narrow()  # this must precede the import of NumPy by a command's module
        with suppress(ImportError):  # other versions of tyro may need neither
            import_lightly("typeguard", "pydantic_core.core_schema")
        declare_late()
        commands = COMMANDS
    command = parse(arguments, commands, program="phy124", description=__doc__)
    from phy124.commands.kinds import refuse_other_kind

    refuse_other_kind(arguments[0], command)
    return command


def _note(message: Warning | str, *_: object) -> None:
    """Log a warning as one line, without the line of code that caused the warning."""
    print(f"phy124: {message}", file=sys.stderr)


def _report(problem: BaseException, *, as_json: bool, verbose: bool) -> int:
    """Print an error message, with `as_json` also as JSON to standard output; return the status."""
    from phy124.runtime.installation import with_program

    cause = failure(problem)
    message = with_program(cause.sentence)
    if as_json:
        print(json.dumps({"error": message}))
    print(f"phy124: {message}", file=sys.stderr)
    if verbose:
        traceback.print_exception(problem)
    return cause.status


if __name__ == "__main__":
    program()
