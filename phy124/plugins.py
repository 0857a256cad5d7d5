"""Plugins: classes and functions from outside phy124, by instance or by name.

In Python a material, force or boundary of your own is passed as an instance. A package gives it a
name that scene files and the command line know by an entry point of one of the `GROUPS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any, get_args

from pydantic_core import core_schema

from phy124.errors import InputError
from phy124.section import Section

GROUPS = ("materials", "forces", "boundaries", "generators", "sinks")
"""Entry points are phy124.materials, phy124.forces and so on; the bridge reads phy124.sinks."""


@cache
def installed(group: str) -> dict[str, EntryPoint]:
    """What packages have registered in one of the `GROUPS`, by name.

    It is read once: packages' metadata takes milliseconds, and a scene may name thousands of kinds.
    """
    points = entry_points(group=f"phy124.{group}")
    return {point.name: point for point in reversed(list(points))}


def registered(group: str, name: str) -> Any:
    """What a package has registered under a name in one of the `GROUPS`; None if nothing.

    Raises:
        InputError: It cannot be loaded.
    """
    point = installed(group).get(name)
    if point is None:
        return None
    try:
        return point.load()
    except Exception as error:
        limit = f"the entry point {point.value} cannot be loaded ({error})."
        remedy = "Install what it needs, or remove the package that names it."
        raise InputError(f"phy124.{group}", name, limit, remedy) from error


def names(group: str) -> list[str]:
    """All names that packages have registered in a group, in alphabetical order."""
    return sorted(installed(group))


def registered_kinds(group: str, base: type[Section]) -> dict[str, type[Section]]:
    """The classes that packages have registered, by name; those that are broken are left out.

    They are refused when a scene names them, so that one broken package stops nothing else.
    """
    found = {}
    for name in names(group):
        try:
            kind = registered(group, name)
        except InputError:
            continue
        if isinstance(kind, type) and issubclass(kind, base):
            found[name] = kind
    return found


@dataclass(frozen=True)
class OpenTo:
    """Lets a field of several kinds take kinds from outside, and adds them to its JSON schema."""

    base: type[Section]
    """Class of all kinds."""
    tag: str
    """The field that names the kind, "law" or "kind"."""
    group: str
    """One of the `GROUPS`."""
    known: Any
    """The union of phy124's own kinds, which a plugin cannot replace."""

    @cached_property
    def own(self) -> frozenset[str]:
        """Names of phy124's own kinds."""
        return frozenset(kind.model_fields[self.tag].default for kind in get_args(self.known))

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.no_info_wrap_validator_function(self._accept, handler(source))

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        schema = handler(core)
        for name, kind in registered_kinds(self.group, self.base).items():
            if name not in self.own:
                # As an item of a list a class gets an entry under "$defs" and a reference to it.
                items = core_schema.list_schema(kind.__pydantic_core_schema__)
                told = handler(items)["items"]
                schema["oneOf"].append(told)
                schema["discriminator"]["mapping"][name] = told["$ref"]
        return schema

    def _accept(self, value: Any, usual: Callable[[Any], Any]) -> Any:
        if isinstance(value, self.base):
            return value
        name = value.get(self.tag) if isinstance(value, dict) else None
        if not isinstance(name, str) or name in self.own:
            return usual(value)
        kind = registered(self.group, name)
        if kind is None:
            return usual(value)
        if not (isinstance(kind, type) and issubclass(kind, self.base)):
            limit = f"what is registered under this name is no subclass of {self.base.__name__}."
            remedy = "Correct or remove the package that registers it."
            raise InputError(f"phy124.{self.group}", name, limit, remedy)
        return kind.model_validate(value)


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
