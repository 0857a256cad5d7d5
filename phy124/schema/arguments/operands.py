"""The end of the options: what comes after `--` is no option, whatever it looks like."""

from __future__ import annotations

from collections.abc import Sequence

END = "--"


def divided(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """The words before `--`; `--` and what comes after it, empty if nothing does."""
    end = list(arguments).index(END) if END in arguments else len(arguments)
    operands = list(arguments[end:])
    return list(arguments[:end]), [] if operands == [END] else operands


def plainly(operands: Sequence[str]) -> list[str]:
    """The same operands, none of which looks like an option: `-x.png` is `./-x.png`.

    The parser (tyro) forgets `--` after a value that is no option.
    """
    return [*operands[:1], *(f"./{text}" if text[:1] == "-" else text for text in operands[1:])]
