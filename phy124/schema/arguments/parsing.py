"""Parse a command line into a command; tyro's errors become `InputError`s."""

import itertools
import os
import re
import shutil
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import reduce
from importlib import import_module
from operator import or_
from types import NoneType, UnionType
from typing import Any, Union, get_args

from phy124.errors import InputError, did_you_mean, suggest
from phy124.schema.arguments.words import (
    expand_home,
    join_repeats,
    list_fields,
    list_positionals,
    split_operands,
)

NARROWEST = 40
"""Smallest width for which help texts are laid out [characters]."""
SIMILAR = 0.75
"""Smallest similarity (0 to 1) at which a known option is suggested for an unknown option."""
KINDS = {"INT": "a whole number", "FLOAT": "a number"}
Commands = Mapping[str, type]


class Answered(SystemExit):
    """Ends the program after the parser has printed its answer, such as the help text."""


def parse(
    arguments: Sequence[str],
    commands: Commands,
    *,
    program: str,
    description: str | None = None,
    empty: Container[str] = (),
) -> Any:
    """Parse a command with its options.

    Args:
        arguments: The arguments after the program's name. An empty list means --help.
        commands: Classes of the commands, by name.
        program: The program's name.
        description: The first paragraph of `--help`.
        empty: Names of options whose value may be empty.

    Raises:
        InputError: The arguments are invalid.
        Answered: The parser has printed help or a completion script.
    """
    import tyro

    options, operands = split_operands([expand_home(word) for word in arguments])
    arguments = [*options, *operands] or ["--help"]
    _refuse_empty(arguments, commands, program, empty)
    name = arguments[0]

    def parse_once() -> Any:
        translate = _translate_errors(arguments, commands, program)
        with translate, _ensure_width(), _no_empty_defaults():
            return tyro.extras.subcommand_cli_from_dict(
                {name: commands[name]} if name in commands else dict(commands),
                prog=program,
                description=description,
                args=join_repeats(arguments, commands),
                registry=_registry(),
            )

    if not any(word.startswith(("-h", "--help", "--tyro-")) for word in arguments):
        with (
            _no_help_texts(),
            suppress(InputError),
        ):  # parsed again to get an error message with help texts
            return parse_once()
    return parse_once()


def asks_for_commands(arguments: Sequence[str]) -> bool:
    """Return whether the arguments ask for the list of all commands."""
    return not arguments or arguments[0] in ("-h", "--help")


def _registry() -> Any:
    from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

    registry = ConstructorRegistry()

    @registry.primitive_rule
    def optional(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
        kinds = get_args(info.type)
        if info.type_origin not in (Union, UnionType) or NoneType not in kinds:
            return None
        rest = reduce(or_, (kind for kind in kinds if kind is not NoneType))
        spec = registry.get_primitive_spec(PrimitiveTypeInfo.make(rest, info.markers))
        if not isinstance(spec, PrimitiveConstructorSpec):
            return None
        known, text = spec.is_instance, spec.str_from_instance
        return replace(
            spec,
            is_instance=lambda value: value is None or known(value),
            str_from_instance=lambda value: [] if value is None else text(value),
        )

    return registry


@contextmanager
def _translate_errors(arguments: Sequence[str], commands: Commands, program: str) -> Iterator[None]:
    try:
        from tyro._errors import on_parse_error
    except ImportError:  # other versions of tyro print their message themselves
        on_parse_error = nullcontext

    def hook(event: Any) -> None:
        try:
            error = _explain(event, arguments, commands, program)
        except (AttributeError, LookupError):
            return  # an event of another version of tyro, which prints its message itself
        if error is not None:
            raise _Refused(error)

    try:
        with on_parse_error(hook):
            yield
    except _Refused as refused:
        raise refused.error from None
    except SystemExit as end:
        raise Answered(end.code) from None


@contextmanager
def _no_help_texts() -> Iterator[None]:
    """Prevent the parser from searching the source code for help texts, which would be slow."""
    wrappers = {
        "get_field_docstring": lambda _: lambda *_: None,
        "get_callable_description": lambda _: lambda _: "",
    }
    with _wrap_functions("_docstrings", wrappers):
        yield


@contextmanager
def _no_empty_defaults() -> Iterator[None]:
    """Omit uninformative defaults from help texts: False, None and empty lists."""

    def wrap(describe: Callable[..., Any]) -> Callable[..., Any]:
        def describe_briefly(argument: Any, *rest: Any, **options: Any) -> Any:
            field = argument.field
            empty = field.default is False or field.default is None or field.default == ()
            if empty and field.argconf.help_behavior_hint is None:
                brief = replace(field.argconf, help_behavior_hint="")
                argument = replace(argument, field=replace(field, argconf=brief))
            return describe(argument, *rest, **options)

        return describe_briefly

    with _wrap_functions("_arguments", {"generate_argument_helptext": wrap}):
        yield


@contextmanager
def _wrap_functions(module: str, wrappers: Mapping[str, Callable[[Any], Any]]) -> Iterator[None]:
    try:
        place = import_module(f"tyro.{module}")
    except ImportError:
        yield
        return
    usual = {name: getattr(place, name) for name in wrappers if hasattr(place, name)}
    try:
        for name, function in usual.items():
            setattr(place, name, wrappers[name](function))
        yield
    finally:
        for name, function in usual.items():
            setattr(place, name, function)


@contextmanager
def _ensure_width() -> Iterator[None]:
    """Lay out help texts at least `NARROWEST` characters wide; tyro hangs at a smaller width."""
    usual = os.environ.get("COLUMNS")
    if shutil.get_terminal_size().columns < NARROWEST:
        os.environ["COLUMNS"] = str(NARROWEST)
    try:
        yield
    finally:
        os.environ.pop("COLUMNS", None)
        os.environ.update({} if usual is None else {"COLUMNS": usual})


class _Refused(Exception):
    """Wraps an InputError. The parser would catch the InputError itself as a ValueError."""

    def __init__(self, error: InputError) -> None:
        self.error = error


def _refuse_empty(
    arguments: Sequence[str], commands: Commands, program: str, empty: Container[str]
) -> None:
    name = arguments[0]
    if name not in commands and not name.startswith(("-h", "--help", "--tyro-")):
        if name.startswith("-"):
            remedy = f"Write `{program} COMMAND ... {name}`; commands are {', '.join(commands)}."
            raise InputError("command", name, "the command comes first.", remedy)
        raise InputError("command", name, "there is no such command.", suggest(name, [*commands]))
    options = split_operands(arguments)[0]
    _refuse_named_positionals(options, commands, program)
    for number, (before, text) in enumerate(itertools.pairwise(options), 1):
        option, equals, value = text.partition("=")
        if (option if equals else before) in empty:
            continue
        if not text or (equals and not value and option.startswith("--")):
            named = option if equals else before
            dashed = named.startswith("-")
            where = named.lstrip("-") if dashed else f"argument {number}"
            remedy = f"Give a value, or remove the {'option' if dashed else 'argument'}."
            raise InputError(where, "''", "it is empty.", remedy)


def _refuse_named_positionals(options: Sequence[str], commands: Commands, program: str) -> None:
    name = options[0]
    unnamed = list_positionals(commands[name]) if name in commands else []
    named = option_names(commands[name]) if unnamed else []
    for text in options[1:]:
        option = text.partition("=")[0]
        if option in named or not option.startswith("--"):
            continue
        if option[2:].replace("-", "_") in unnamed:
            usage = " ".join([program, name, *(field.upper() for field in unnamed)])
            limit = f"`{program} {name}` takes this value without a name."
            raise InputError("option", option, limit, f"Write `{usage}`.")


def option_names(command: Any) -> list[str]:
    """Return the names of a command's options in the form in which users type them."""
    names: list[str] = []
    unnamed = list_positionals(command)
    for name, kind in list_fields(command).items():
        if name in unnamed:
            continue
        names += option_names(kind) if list_fields(kind) else ["--" + name.replace("_", "-")]
    return names


def _explain(
    event: Any, arguments: Sequence[str], commands: Commands, program: str
) -> InputError | None:
    name, command = type(event).__name__, arguments[0]
    if name == "UnrecognizedArgs":
        options = option_names(commands[command])
        return _explain_unknown(event.tokens, f"{program} {command}", options)
    explain: dict[str, Callable[[Any], InputError]] = {
        "MissingArgs": _explain_missing,
        "BadValue": _explain_number_of_values,
        "InvalidChoice": _explain_choice,
        "InstantiationFailure": _explain_type,
    }
    return explain[name](event) if name in explain else None


def _explain_missing(event: Any) -> InputError:
    argument = event.missing_arguments[0].arg
    return InputError(_name(argument), "nothing", "it is required.", _help(argument))


def _explain_number_of_values(event: Any) -> InputError:
    count = event.argument.lowered.nargs
    needed = f"{count} values" if isinstance(count, int) and count > 1 else "a value"
    limit = f"it needs {needed}." if event.offending_value is None else "it takes no value."
    value = event.offending_value or "nothing"
    return InputError(_name(event.argument), value, limit, _help(event.argument))


def _explain_choice(event: Any) -> InputError:
    limit = "there is no such choice."
    remedy = suggest(event.value, event.choices)
    return InputError(_name(event.argument), event.value, limit, remedy)


def _explain_type(event: Any) -> InputError:
    if event.argument is None:
        raise LookupError("the command-line parser reports no argument for this error")
    metavar = event.argument.lowered.metavar or ""
    kind = next((words for name, words in KINDS.items() if name in metavar), None)
    # The parser's message ends in the values: "... from ['x']" or "...: 'x'".
    message = event.message
    values = message.partition("[")[2].partition("]")[0] or message.rpartition(": ")[2]
    value = " ".join(part.strip(" '\"") for part in values.split(",") if part.strip())
    limit = f"it is not {kind}." if kind else "it cannot be used."
    return InputError(_name(event.argument), value or "?", limit, _help(event.argument))


def _explain_unknown(tokens: Sequence[str], command: str, options: Sequence[str]) -> InputError:
    strange = [token for token in tokens if token.startswith("-")]
    if not strange:
        limit = f"`{command}` takes no more values."
        return InputError("argument", tokens[0], limit, f"See `{command} --help`.")
    name = strange[0].partition("=")[0]
    hint = did_you_mean(name, options, similarity=SIMILAR) or f"See `{command} --help`."
    return InputError("option", name, f"`{command}` has no such option.", hint)


def _name(argument: Any) -> str:
    return argument.field.intern_name.rpartition(".")[2].replace("_", "-")


def _help(argument: Any) -> str:
    text = argument.field.helptext
    text = text() if callable(text) else text
    if not text:
        return "See --help."
    paragraph = " ".join(str(text).strip().partition("\n\n")[0].split())
    sentence = re.split(r"(?<=\.) (?=[A-Z])", paragraph)[0]
    return f"It is: {sentence.rstrip('.')}."
