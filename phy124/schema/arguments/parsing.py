"""Parses a command line into a command; errors of the parser are worded like all others.

The parser (tyro) passes the reason for giving up to a hook of ours. If another version of it does
not, its own message is shown.
"""

from __future__ import annotations

import itertools
import os
import shutil
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any

from phy124.errors import InputError, did_you_mean, meant
from phy124.schema.arguments.homes import from_home
from phy124.schema.arguments.operands import divided
from phy124.schema.arguments.repeats import gathered, members, positionals

NARROWEST = 40
"""Fewest columns that help is laid out for."""
KINDS = {"INT": "a whole number", "FLOAT": "a number"}
Commands = Mapping[str, type]


class Answered(SystemExit):
    """The parser has printed what was asked for, such as --help; nothing is left to do."""


def parsed(
    arguments: Sequence[str],
    commands: Commands,
    *,
    program: str,
    description: str | None = None,
    empty: Container[str] = (),
) -> Any:
    """The command with its options.

    Args:
        arguments: The words typed after the program's name; none asks for help.
        commands: Name -> class.
        program: The program's name.
        description: The first paragraph of `--help`.
        empty: Names of options that may be empty.

    Raises:
        InputError: If the arguments cannot be understood.
        Answered: The parser has answered itself.
    """
    import tyro

    options, operands = divided([from_home(word) for word in arguments])
    arguments = [*options, *operands] or ["--help"]
    _refuse(arguments, commands, program, empty)
    name = arguments[0]
    with _plainly(arguments, commands, program), _wide_enough():
        return tyro.extras.subcommand_cli_from_dict(
            {name: commands[name]} if name in commands else dict(commands),
            prog=program,
            description=description,
            args=gathered(arguments, commands),
        )


def asks_for_commands(arguments: Sequence[str]) -> bool:
    """Whether the list of all commands is asked for, and nothing else can happen."""
    return not arguments or arguments[0] in ("-h", "--help")


@contextmanager
def _plainly(arguments: Sequence[str], commands: Commands, program: str) -> Iterator[None]:
    """Within this context errors of the parser are raised as InputError."""
    try:
        from tyro._errors import on_parse_error
    except ImportError:  # another version, whose own words must do
        on_parse_error = nullcontext

    def hook(event: Any) -> None:
        try:
            refusal = _refusal(event, arguments, commands, program)
        except (AttributeError, LookupError):
            return  # Events of another version: the parser's own words must do.
        if refusal is not None:
            raise _Refused(refusal)

    try:
        with on_parse_error(hook):
            yield
    except _Refused as found:
        raise found.refusal from None
    except SystemExit as end:
        raise Answered(end.code) from None


@contextmanager
def _wide_enough() -> Iterator[None]:
    """Within this context the terminal has `NARROWEST` columns at least, or --help never ends."""
    usual = os.environ.get("COLUMNS")
    if shutil.get_terminal_size().columns < NARROWEST:
        os.environ["COLUMNS"] = str(NARROWEST)
    try:
        yield
    finally:
        os.environ.pop("COLUMNS", None)
        os.environ.update({} if usual is None else {"COLUMNS": usual})


class _Refused(Exception):
    """Carries an error past the parser, which catches ValueError."""

    def __init__(self, refusal: InputError) -> None:
        self.refusal = refusal


def _refuse(
    arguments: Sequence[str], commands: Commands, program: str, empty: Container[str]
) -> None:
    """Raise InputError if the first argument is no command, or an argument is empty."""
    name = arguments[0]
    if name not in commands and not name.startswith(("-h", "--help", "--tyro-")):
        if name.startswith("-"):
            remedy = f"Write `{program} COMMAND ... {name}`; commands are {', '.join(commands)}."
            raise InputError("command", name, "the command comes first.", remedy)
        raise InputError("command", name, "there is no such command.", meant(name, [*commands]))
    options = divided(arguments)[0]
    _refuse_names(options, commands, program)
    for before, text in itertools.pairwise(options):
        option, equals, value = text.partition("=")
        if (option if equals else before) in empty:
            continue
        if not text or (equals and not value and option.startswith("--")):
            where = option.lstrip("-") if equals else before.lstrip("-")
            raise InputError(where, "''", "it is empty.", "Give a value, or leave the option out.")


def _refuse_names(options: Sequence[str], commands: Commands, program: str) -> None:
    """Raise InputError if something that has no option is given by its name, as `--output X`."""
    name = options[0]
    unnamed = positionals(commands[name]) if name in commands else []
    named = option_names(commands[name]) if unnamed else []
    for text in options[1:]:
        option = text.partition("=")[0]
        if option in named or not option.startswith("--"):
            continue
        if option[2:].replace("-", "_") in unnamed:
            usage = " ".join([program, name, *(field.upper() for field in unnamed)])
            limit = f"`{program} {name}` takes it without a name."
            raise InputError("option", option, limit, f"Write `{usage}`.")


def option_names(command: Any) -> list[str]:
    """Names of a command's options, as they are typed."""
    found: list[str] = []
    unnamed = positionals(command)
    for name, kind in members(command).items():
        if name in unnamed:
            continue
        found += option_names(kind) if members(kind) else ["--" + name.replace("_", "-")]
    return found


def _refusal(
    event: Any, arguments: Sequence[str], commands: Commands, program: str
) -> InputError | None:
    """The error for an event of the parser; None if the event is not known here."""
    name, command = type(event).__name__, arguments[0]
    if name == "UnrecognizedArgs":
        return _unknown(event.tokens, f"{program} {command}", option_names(commands[command]))
    makers: dict[str, Callable[[Any], InputError]] = {
        "MissingArgs": _missing,
        "BadValue": _bad_value,
        "InvalidChoice": _no_choice,
        "InstantiationFailure": _not_made,
    }
    return makers[name](event) if name in makers else None


def _missing(event: Any) -> InputError:
    argument = event.missing_arguments[0].arg
    name = _name(argument)
    return InputError(name, "nothing", "it is needed.", _help(argument, "It is"))


def _bad_value(event: Any) -> InputError:
    count = event.argument.lowered.nargs
    needed = f"{count} values" if isinstance(count, int) and count > 1 else "a value"
    limit = f"it needs {needed}." if event.offending_value is None else "it takes no value."
    value = event.offending_value or "nothing"
    return InputError(_name(event.argument), value, limit, _help(event.argument, "It is"))


def _no_choice(event: Any) -> InputError:
    choices = [choice for choice in event.choices if choice != "None"]
    limit = "there is no such choice."
    return InputError(_name(event.argument), event.value, limit, meant(event.value, choices))


def _not_made(event: Any) -> InputError:
    if event.argument is None:
        raise LookupError("the parser does not say which argument")
    metavar = event.argument.lowered.metavar or ""
    kind = next((said for name, said in KINDS.items() if name in metavar), None)
    value = " ".join(_given(event.message))
    limit = f"it is not {kind}." if kind else "it cannot be used."
    return InputError(_name(event.argument), value or "?", limit, _help(event.argument, "It is"))


def _given(message: str) -> list[str]:
    """The values that a message of the parser names: "... from ['x']", "...: 'x'"."""
    inside = message.partition("[")[2].partition("]")[0] or message.rpartition(": ")[2]
    return [part.strip().strip("'\"") for part in inside.split(",") if part.strip()]


def _unknown(tokens: Sequence[str], command: str, options: Sequence[str]) -> InputError:
    """Words that are no option of the command, or more values than it takes."""
    strange = [token for token in tokens if token.startswith("-")]
    if not strange:
        limit = f"`{command}` takes no more values."
        return InputError("argument", tokens[0], limit, f"See `{command} --help`.")
    name = strange[0].partition("=")[0]
    hint = did_you_mean(name, options) or f"See `{command} --help`."
    return InputError("option", name, f"`{command}` has no such option.", hint)


def _name(argument: Any) -> str:
    return argument.field.intern_name.rpartition(".")[2].replace("_", "-")


def _help(argument: Any, verb: str) -> str:
    text = argument.field.helptext
    text = (text() if callable(text) else text) or ""
    return f"{verb}: {text.strip().splitlines()[0].rstrip('.')}." if text else "See --help."
