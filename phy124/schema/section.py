"""Base class of all declared options: of scenes, of the page and of the bridge."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

if TYPE_CHECKING:
    from typing_extensions import Self

OTHER = PydanticCustomError("another_type", "it is of another type")


class Section(BaseModel):
    """A group of options that cannot be changed; unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)
    AS_TEXT: ClassVar[bool] = False
    """Whether all values are texts, so that "yes" is accepted as a boolean."""

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

    @classmethod
    def of(cls, options: Self | Mapping[str, Any]) -> Self:
        """Return options that may be plain data as an object of this class.

        Raises:
            InputError: A value is invalid, or there is no such option.
        """
        try:
            return cls.model_validate(options)
        except ValidationError as error:
            from phy124.schema.refusals import explain

            raise explain(error, cls.__name__, cls) from None


@cache
def _list_types(section: type[Section], field: str) -> frozenset[Any]:
    """Return the types of plain values that a field accepts; empty if it accepts any type."""
    types, annotations = set(), [section.model_fields[field].annotation]
    while annotations:
        annotation = annotations.pop()
        parts = get_args(annotation)
        annotations += [part for part in parts if part is not ...]
        if not parts:
            types.add(annotation if isinstance(annotation, type) else type(annotation))
    return frozenset() if {object, type(Any)} & types or Any in types else frozenset(types)


def _is_other(value: Any, types: frozenset[Any]) -> bool:
    """Return whether the type of a plain value is not listed."""
    if not types:
        return False
    if bool not in types:
        return _contains_boolean(value)
    return isinstance(value, str | int | float) and type(value) not in types


def _contains_boolean(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_contains_boolean, value))
    return isinstance(value, bool)
