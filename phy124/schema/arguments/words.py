"""Prepares the words of a command line for the parser."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from phy124.errors import InputError

END = "--"
"""Marks the end of the options. Later arguments are operands, even if they look like options."""
_BEFORE_HOME = re.compile(r"(?:[\w.-]+=)*(?=~)")
"""Matches the text before a `~`, such as --out=, object.file= or --set=object.file=."""


def expand_home(word: str) -> str:
    """Expand `~` at the start of a path; shells do not expand it after an equals sign.

    If the home folder does not exist, the argument is unchanged.
    """
    prefix = _BEFORE_HOME.match(word)
    if prefix is None:
        return word
    return prefix[0] + os.path.expanduser(word[prefix.end() :])


def split_operands(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split the arguments at `--`.

    The second list starts with `--`, or is empty if there are no operands.
    """
    end = list(arguments).index(END) if END in arguments else len(arguments)
    operands = list(arguments[end:])
    return list(arguments[:end]), [] if operands == [END] else operands


def join_repeats(arguments: Sequence[str], commands: Mapping[str, type]) -> list[str]:
    """Join the values of list options that are repeated.

    The parser (tyro) would otherwise use only the last value. Operands that look like options are
    rewritten (`-x.png` becomes `./-x.png`), because tyro ignores `--` after a positional value.

    Raises:
        InputError: An option has two different values.
    """
    if not arguments or arguments[0] not in commands:
        return list(arguments)
    lists = list_options(commands[arguments[0]])
    arguments, operands = split_operands(arguments)
    rest: list[str] = []
    joined: dict[str, list[str]] = {}
    single: dict[str, str | None] = {}
    for name, values in _group_by_option(arguments):
        if name in lists:
            # An option with `=` has a single value; later arguments do not belong to this option.
            joined.setdefault(name, []).extend(values)
            continue
        value = values[0] if values else None
        if name and single.setdefault(name, value) != value:
            limit = f"the option has two values, {single[name]} and {value}."
            raise InputError(name.removeprefix("--"), value, limit, "Give it once.")
        if name and value and value.startswith("-") and value != "-h":
            # Without `=`, the parser would mistake the value for an option: `--front -y`.
            name, values = f"{name}={value}", values[1:]
        rest += [name, *values] if name else values
    for name, values in joined.items():
        rest += [name, *values]
    paths = (f"./{word}" if word.startswith("-") else word for word in operands[1:])
    return [*rest, *operands[:1], *paths]


def list_options(command: Any) -> set[str]:
    """Return the names of a command's options that accept any number of values."""
    names: set[str] = set()
    for name, kind in list_fields(command).items():
        if list_fields(kind):
            names |= list_options(kind)
        elif any(Ellipsis in get_args(option) for option in (kind, *get_args(kind))):
            names.add("--" + name.replace("_", "-"))
    return names


def list_positionals(command: Any) -> list[str]:
    """Return the names of a command's positional arguments, in order."""
    import tyro

    hints = get_type_hints(command, include_extras=True)
    return [name for name, hint in hints.items() if tyro.conf.Positional in get_args(hint)[1:]]


def list_fields(kind: Any) -> dict[str, Any]:
    """Return the types of a dataclass's or pydantic model's fields by name; {} for other types."""
    if is_dataclass(kind):
        names = [field.name for field in fields(kind)]
    else:
        names = [*getattr(kind, "model_fields", ())]
    hints = get_type_hints(kind, include_extras=True) if names else {}
    return {name: _strip_annotated(hints[name]) for name in names}


def _strip_annotated(annotation: Any) -> Any:
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    return annotation


def _group_by_option(arguments: Sequence[str]) -> list[tuple[str, list[str]]]:
    groups: list[tuple[str, list[str]]] = [("", [])]
    for word in arguments:
        if not word.startswith("--"):
            groups[-1][1].append(word)
            continue
        name, equals, value = word.partition("=")
        groups.append((name.replace("_", "-"), [value] if equals else []))
        if equals:
            groups.append(("", []))
    return groups
