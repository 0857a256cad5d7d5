"""Options given more than once: lists are joined, anything else must be consistent.

argparse, which reads the command line, silently keeps the last one only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from phy124.errors import InputError
from phy124.schema.arguments.operands import divided, plainly


def gathered(arguments: Sequence[str], commands: Mapping[str, type]) -> list[str]:
    """The same arguments with each option once.

    Raises:
        InputError: If an option is given twice with different values.
    """
    if not arguments or arguments[0] not in commands:
        return list(arguments)
    lists = list_options(commands[arguments[0]])
    arguments, operands = divided(arguments)
    rest: list[str] = []
    listed: dict[str, list[str]] = {}
    single: dict[str, str | None] = {}
    for name, values in _options(arguments):
        if name in lists:
            # With `=` an option has that one value; what follows is not its own.
            listed.setdefault(name, []).extend(values)
            continue
        value = values[0] if values else None
        if name and single.setdefault(name, value) != value:
            limit = f"it is given twice, as {single[name]} and as {value}."
            raise InputError(name.removeprefix("--"), value, limit, "Give it once.")
        if name and value and value.startswith("-") and value != "-h":
            # Else it would be taken for an option: `--front -y`.
            name, values = f"{name}={value}", values[1:]
        rest += [name, *values] if name else values
    gathered = [text for name, values in listed.items() for text in (name, *values)]
    return [*rest, *gathered, *plainly(operands)]


def list_options(command: Any) -> set[str]:
    """Names of a command's options that take any number of values."""
    found: set[str] = set()
    for name, kind in members(command).items():
        if members(kind):
            found |= list_options(kind)
        elif any(Ellipsis in get_args(one) for one in (kind, *get_args(kind))):
            found.add("--" + name.replace("_", "-"))
    return found


def positionals(command: Any) -> list[str]:
    """Names of what a command takes without an option, in order."""
    import tyro

    hints = get_type_hints(command, include_extras=True)
    return [name for name, hint in hints.items() if tyro.conf.Positional in get_args(hint)[1:]]


def members(kind: Any) -> dict[str, Any]:
    """Name -> type of the fields of a dataclass or a pydantic model; empty for other types."""
    names = (
        [f.name for f in fields(kind)]
        if is_dataclass(kind)
        else [*getattr(kind, "model_fields", ())]
    )
    hints = get_type_hints(kind, include_extras=True) if names else {}
    return {name: plain(hints[name]) for name in names}


def plain(annotation: Any) -> Any:
    """The type inside `Annotated`."""
    return plain(get_args(annotation)[0]) if get_origin(annotation) is Annotated else annotation


def _options(arguments: Sequence[str]) -> list[tuple[str, list[str]]]:
    """Each option with the words after it; words before any option come first, without a name."""
    found: list[tuple[str, list[str]]] = [("", [])]
    for text in arguments:
        if not text.startswith("--"):
            found[-1][1].append(text)
            continue
        name, equals, value = text.partition("=")
        found.append((name.replace("_", "-"), [value] if equals else []))
        if equals:
            found.append(("", []))
    return found
