"""Reads a scene's TOML file, checks its nesting depth, and lists the files that it names."""

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


DEEPEST = 32
"""Largest nesting depth of tables and lists, which limits recursion; a scene needs eight levels."""


def read_toml(path: str | os.PathLike[str], field: str) -> dict[str, Any]:
    """Read a TOML file. In error messages, the file is called `field`.

    Raises:
        InputError: The file cannot be read or is not TOML.
    """
    try:
        return tomllib.loads(Path(path).read_text("utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        preset = " or a preset name" if field == "scene" else ""
        limit, remedy = "it is not text in UTF-8.", "Save it again in this encoding."
        if isinstance(error, OSError):
            limit, remedy = f"it cannot be read: {error.strerror}.", f"Give a TOML file{preset}."
        if isinstance(error, FileNotFoundError):
            limit = "there is no such file."
    except RecursionError:
        limit, remedy = (
            "its lists are nested too deep.",
            "Remove whatever is not part of a scene.",
        )
    except tomllib.TOMLDecodeError as error:
        limit, remedy = f"it is not valid TOML: {error}.", "Correct that line."
    except ValueError:  # raised by Python, which limits the number of digits of an integer
        limit, remedy = "it contains a number of thousands of digits.", "Shorten that number."
    raise InputError(field, path, limit, remedy)


def read_cameras(path: str | os.PathLike[str]) -> list[Any]:
    """Read the cameras in a TOML file, as plain data.

    Raises:
        InputError: The file cannot be read, or contains anything but cameras.
    """
    data = read_toml(path, "cameras")
    view = data.get("view")
    if set(data) != {"view"} or not isinstance(view, dict) or set(view) != {"cameras"}:
        limit = "it must contain only cameras, each below a line [[view.cameras]]."
        raise InputError("cameras", path, limit, "Use --scene for a file of a whole scene.")
    return view["cameras"]


def check_depth(data: Any, field: str) -> None:
    """Refuse plain data that is nested too deep. In error messages, the data is called `field`.

    Raises:
        InputError: The data is nested deeper than `DEEPEST`.
    """

    def list_inner(section: Any) -> list[Any]:
        parts = section.values() if isinstance(section, dict) else section
        return [part for part in parts if isinstance(part, dict | list | tuple)]

    level = list_inner([data])
    for _ in range(DEEPEST):
        level = [inner for outer in level for inner in list_inner(outer)]
        if not level:
            return
    limit = f"it is nested more than {DEEPEST} levels deep."
    raise InputError(field, "nested data", limit, "Remove whatever is not part of a scene.")


def files_named(section: Any, field: str = "") -> Iterator[tuple[str, Path]]:
    """Yield each file that a scene names, with the dotted path of its field."""
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
    """Refuse a scene that names a missing or unreadable file.

    Raises:
        InputError: A file is missing or unreadable.
    """
    for field, path in files_named(section):
        if hindrance := obstacle(path):
            raise InputError(field, path, *hindrance)
