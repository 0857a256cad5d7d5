"""Base class of all declared options: of scenes, of the page and of the bridge."""

import re
import sys
import tokenize
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

LINES = re.compile(
    r'^(?P<top>class|def) (?P<name>\w+)|^    (?:(?P<field>\w+): |def |@|"""(?P<text>.+?)"""$)',
    re.MULTILINE | re.DOTALL,
)
OTHER = PydanticCustomError("another_type", "it is of another type")


class Section(BaseModel):
    """A group of options that cannot be changed; unknown keys are errors.

    The docstring below a field describes the field in messages, help texts and references.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)
    AS_TEXT: ClassVar[bool] = False
    """Whether all values of the section are texts. A boolean field then accepts "yes", for example.
    """

    @classmethod
    def __pydantic_init_subclass__(cls, **options: Any) -> None:
        """Set the fields' descriptions; pydantic's `use_attribute_docstrings` would take 0.2 s."""
        file = getattr(sys.modules.get(cls.__module__), "__file__", None)
        for name, text in _read_docstrings(file).get(cls.__name__, {}).items():
            if name in cls.model_fields:
                cls.model_fields[name].description = text

    # A validator for each field is impossible, because pydantic allows none for discriminators.
    @model_validator(mode="before")
    @classmethod
    def _check_types(cls, data: Any) -> Any:
        """Refuse values that pydantic would convert: True to a number, "yes" or 1 to a boolean."""
        if cls.AS_TEXT or not isinstance(data, dict):
            return data
        wrong = [
            InitErrorDetails(type=OTHER, loc=(name,), input=value)
            for name, value in data.items()
            if name in cls.model_fields and _is_other(value, _list_types(cls, name))
        ]
        if wrong:
            raise ValidationError.from_exception_data(cls.__name__, wrong)
        return data


def omit_default(default: Any, **limits: Any) -> Any:
    """Return a `pydantic.Field` with limits; files omit a field that has the default value."""
    return Field(default=default, exclude_if=lambda value: value == default, **limits)


@cache
def _read_docstrings(file: str | None) -> dict[str, dict[str, str]]:
    texts: dict[str, dict[str, str]] = {}
    if file is None or not file.endswith(".py") or not Path(file).is_file():
        return texts
    section = field = ""
    with tokenize.open(file) as source:
        lines = LINES.finditer(source.read())
    for line in lines:
        if line["top"]:
            section = line["name"] if line["top"] == "class" else ""
        if line["text"] and section and field:
            texts.setdefault(section, {})[field] = " ".join(line["text"].split())
        field = line["field"] or ""
    return texts


@cache
def _list_types(section: type[Section], field: str) -> frozenset[Any]:
    types, annotations = set(), [section.model_fields[field].annotation]
    while annotations:
        annotation = annotations.pop()
        parts = get_args(annotation)
        annotations += [part for part in parts if part is not ...]
        if not parts:
            types.add(annotation if isinstance(annotation, type) else type(annotation))
    return frozenset() if {object, type(Any)} & types or Any in types else frozenset(types)


def _is_other(value: Any, types: frozenset[Any]) -> bool:
    if not types:
        return False
    if bool not in types:
        return _contains_boolean(value)
    return isinstance(value, str | int | float) and type(value) not in types


def _contains_boolean(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_contains_boolean, value))
    return isinstance(value, bool)
