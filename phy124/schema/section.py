"""Base class of all declared options: those of a scene, of the page and of the bridge."""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

OTHER = PydanticCustomError("another_type", "it is of another type")


class Section(BaseModel):
    """A frozen group of options; unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    AS_TEXT: ClassVar[bool] = False
    """Whether its values come as text, so that "yes" is a boolean."""

    # Not for each field: pydantic takes none for the keys that tell kinds apart.
    @model_validator(mode="before")
    @classmethod
    def _as_declared(cls, data: Any) -> Any:
        """Refuse what pydantic would convert: True as a number, "yes" or 1 as a boolean."""
        if cls.AS_TEXT or not isinstance(data, dict):
            return data
        wrong = [
            InitErrorDetails(type=OTHER, loc=(name,), input=value)
            for name, value in data.items()
            if name in cls.model_fields and _is_other(value, _kinds(cls, name))
        ]
        if wrong:
            raise ValidationError.from_exception_data(cls.__name__, wrong)
        return data


@cache
def _kinds(section: type[Section], field: str) -> frozenset[Any]:
    """Types of the plain values that a field may have; empty if it may have any."""
    annotation = section.model_fields[field].annotation
    kinds, inside = set(), [annotation]
    while inside:
        one = inside.pop()
        parts = get_args(one)
        inside += [part for part in parts if part is not ...]
        if not parts:
            kinds.add(one if isinstance(one, type) else type(one))
    return frozenset() if {object, type(Any)} & kinds or Any in kinds else frozenset(kinds)


def _is_other(value: Any, kinds: frozenset[Any]) -> bool:
    """Whether a plain value is of another type than those."""
    if not kinds:
        return False
    if bool not in kinds:
        return _holds_boolean(value)
    return isinstance(value, str | int | float) and type(value) not in kinds


def _holds_boolean(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_holds_boolean, value))
    return isinstance(value, bool)
