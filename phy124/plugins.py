"""Plugins: classes and functions from outside phy124, by instance or by name.

In Python a material, force or boundary of your own is passed as an instance. A package gives it a
name that scene files and the command line know by an entry point of one of the `GROUPS`.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any, get_args

from pydantic import ValidationInfo, WrapValidator

from phy124.errors import InputError
from phy124.section import Section

GROUPS = ("materials", "forces", "boundaries", "generators", "sinks")
"""Entry points are phy124.materials, phy124.forces and so on; the bridge reads phy124.sinks."""


def registered(group: str, name: str) -> Any:
    """What a package has registered under a name in one of the `GROUPS`; None if nothing.

    Raises:
        InputError: It cannot be loaded.
    """
    for found in entry_points(group=f"phy124.{group}", name=name):
        try:
            return found.load()
        except Exception as error:
            limit = f"the entry point {found.value} cannot be loaded ({error})."
            remedy = "Install what it needs, or remove the package that names it."
            raise InputError(f"phy124.{group}", name, limit, remedy) from error
    return None


def names(group: str) -> list[str]:
    """All names that packages have registered in a group, in alphabetical order."""
    return sorted(found.name for found in entry_points(group=f"phy124.{group}"))


def open_to(base: type[Section], tag: str, group: str, known: Any) -> WrapValidator:
    """Lets a field of several kinds take a kind from outside.

    Args:
        base: Class of all kinds.
        tag: The field that names the kind, "law" or "kind".
        group: One of the `GROUPS`.
        known: The union of phy124's own kinds, which a plugin cannot replace.
    """
    own = frozenset(kind.model_fields[tag].default for kind in get_args(known))

    def accept(value: Any, usual: Callable[[Any], Any], info: ValidationInfo) -> Any:
        del info
        if isinstance(value, base):
            return value
        name = value.get(tag) if isinstance(value, dict) else None
        if isinstance(name, str) and name not in own:
            kind = registered(group, name)
            if kind is not None:
                return kind.model_validate(value)
        return usual(value)

    return WrapValidator(accept)


def is_foreign(section: Section, known: Any) -> bool:
    """Whether a section is of a class from outside the union of phy124's own kinds."""
    return type(section) not in get_args(known)


def has_name(section: Section, tag: str, group: str, known: Any) -> bool:
    """Whether a file can name the kind of a section: it is phy124's own, or registered.

    Args:
        section: A material, force or boundary.
        tag: The field that names its kind, "law" or "kind".
        group: One of the `GROUPS`.
        known: The union of phy124's own kinds.
    """
    if not is_foreign(section, known):
        return True
    return registered(group, getattr(section, tag, "")) is type(section)
