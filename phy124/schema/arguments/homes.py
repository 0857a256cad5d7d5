"""Paths in a user's home, which shells leave to the program after an equals sign."""

from __future__ import annotations

import os
import re

_BEFORE = re.compile(r"(?:[\w.-]+=)*(?=~)")
"""What may stand before a path: --out=, object.file=, --set=object.file=."""


def from_home(word: str) -> str:
    """A word of the command line, in which a path that begins with ~ leads to the home.

    It stays as it is if there is no such home.
    """
    before = _BEFORE.match(word)
    return word if before is None else before[0] + os.path.expanduser(word[before.end() :])
