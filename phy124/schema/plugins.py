"""Plugins: classes and functions of users, registered as entry points of packages."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any, get_args

from pydantic_core import core_schema

from phy124.errors import InputError
from phy124.schema.section import Section

GROUPS = ("materials", "forces", "boundaries", "generators", "formats", "sinks")
"""Entry-point groups, without the prefix `phy124.`. Only the bridge reads phy124.sinks."""


@cache
def entry_points_of(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of one of the `GROUPS`, by name.

    Cached, because reading the metadata of packages takes milliseconds, and a scene may name
    thousands of kinds.
    """
    points = entry_points(group=f"phy124.{group}")
    return {point.name: point for point in reversed(list(points))}


def load_plugin(group: str, name: str) -> Any:
    """Load the class or function with this entry point; None if there is none.

    Raises:
        InputError: The class or function cannot be loaded.
    """
    point = entry_points_of(group).get(name)
    if point is None:
        return None
    try:
        return point.load()
    except Exception as error:
        limit = f"the entry point {point.value} cannot be loaded ({error})."
        remedy = "Install what it needs, or remove the package that names it."
        raise InputError(f"phy124.{group}", name, limit, remedy) from error


def list_plugins(group: str) -> list[str]:
    """Return the names that packages register in a group, in alphabetical order."""
    return sorted(entry_points_of(group))


def load_kinds(group: str, base: type[Section]) -> dict[str, type[Section]]:
    """Load all classes that packages register; skip classes that cannot be loaded."""
    kinds = {}
    for name in list_plugins(group):
        try:
            kind = load_plugin(group, name)
        except InputError:
            continue
        if isinstance(kind, type) and issubclass(kind, base):
            kinds[name] = kind
    return kinds


@dataclass(frozen=True)
class Kinds:
    """The kinds of section that a field of a scene accepts, including registered plugins.

    Annotate the field with an instance of this class.
    """

    base: type[Section]
    tag: str
    """Name of the field that names the class in files: "law" or "kind"."""
    group: str
    """Entry-point group of the plugins, one of the `GROUPS`."""
    union: Any
    """Union of the classes that phy124 defines. Plugins cannot replace these classes."""

    @cached_property
    def by_name(self) -> dict[str, type[Any]]:
        """The classes that phy124 defines, by name."""
        return {kind.model_fields[self.tag].default: kind for kind in get_args(self.union)}

    def is_foreign(self, section: Section) -> bool:
        """Return whether the class of a section is not defined by phy124."""
        return type(section) not in get_args(self.union)

    def knows(self, data: dict[str, Any]) -> bool:
        """Return whether plain data is a section of a class that phy124 or a plugin defines."""
        name = str(data.get(self.tag, ""))
        kind = self.by_name.get(name) or load_plugin(self.group, name)
        return kind is not None and data.keys() <= kind.model_fields.keys()

    def has_name(self, section: Section) -> bool:
        """Return whether the class of a section has a name in files."""
        if not self.is_foreign(section):
            return True
        return load_plugin(self.group, getattr(section, self.tag, "")) is type(section)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.no_info_wrap_validator_function(self._accept, handler(source))

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        schema = handler(core)
        for name, kind in load_kinds(self.group, self.base).items():
            if name not in self.by_name:
                # If the class is an item of a list, it gets an entry under "$defs" with a
                # reference.
                items = core_schema.list_schema(kind.__pydantic_core_schema__)
                item = handler(items)["items"]
                schema["oneOf"].append(item)
                schema["discriminator"]["mapping"][name] = item["$ref"]
        return schema

    def _accept(self, value: Any, usual: Callable[[Any], Any]) -> Any:
        if isinstance(value, self.base):
            return value
        name = value.get(self.tag) if isinstance(value, dict) else None
        if not isinstance(name, str) or name in self.by_name:
            return usual(value)
        kind = load_plugin(self.group, name)
        if kind is None:
            return usual(value)
        if not (isinstance(kind, type) and issubclass(kind, self.base)):
            limit = (
                f"the class registered under this name is not a subclass of {self.base.__name__}."
            )
            remedy = "Correct or remove the package that registers it."
            raise InputError(f"phy124.{self.group}", name, limit, remedy)
        return kind.model_validate(value)
