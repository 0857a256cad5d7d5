"""The files of a scene: itself, and those that it names for parts, stiffness and properties."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from phy124.errors import InputError
from phy124.io.opening import obstacle

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def read_toml(path: str | os.PathLike[str], field: str) -> dict[str, Any]:
    """The content of a TOML file; `field` is what an error calls it.

    Raises:
        InputError: It cannot be read or is not TOML.
    """
    try:
        return tomllib.loads(Path(path).read_text("utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        given = " or a preset name" if field == "scene" else ""
        raise InputError(
            field, path, f"it cannot be read ({error}).", f"Give a TOML file{given}."
        ) from None
    except RecursionError:
        raise InputError(
            field, path, "its lists are nested too deep.", "Leave out what is no scene."
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            field, path, f"it is not valid TOML: {error}.", "Correct that line."
        ) from None


def files_named(section: Any, field: str = "") -> Iterator[tuple[str, Path]]:
    """Every file that a scene names and the field that names it, whichever section it is in."""
    if isinstance(section, Path):
        yield field, section
    elif isinstance(section, BaseModel):
        for name in type(section).model_fields:
            yield from files_named(getattr(section, name), f"{field}.{name}".strip("."))
    elif isinstance(section, dict | list | tuple):
        items = section.items() if isinstance(section, dict) else enumerate(section)
        for name, value in items:
            yield from files_named(value, f"{field}.{name}")


def refuse_missing(section: BaseModel) -> None:
    """Make sure that the files a scene names are there, before any work is done for it.

    Raises:
        InputError: One of them is not.
    """
    for field, path in files_named(section):
        if hindrance := obstacle(path):
            raise InputError(field, path, *hindrance)
