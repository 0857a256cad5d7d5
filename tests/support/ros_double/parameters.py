"""Parameters of a node: their types, ranges and refusals."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field
from typing import Any


class Type(enum.Enum):
    """rclpy.parameter.Parameter.Type."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9

    @staticmethod
    def of(value: Any) -> Type:
        scalars = {bool: Type.BOOL, int: Type.INTEGER, float: Type.DOUBLE, str: Type.STRING}
        if value is None:
            return Type.NOT_SET
        if type(value) in scalars:
            return scalars[type(value)]
        if not isinstance(value, (list, tuple)):
            raise TypeError(f"The given value is not one of the allowed types '{value}'.")
        arrays = {
            bytes: Type.BYTE_ARRAY,  # an empty list also has this type
            bool: Type.BOOL_ARRAY,
            int: Type.INTEGER_ARRAY,
            float: Type.DOUBLE_ARRAY,
            str: Type.STRING_ARRAY,
        }
        for kind, array in arrays.items():
            if all(type(element) is kind for element in value):
                return array
        raise TypeError(f"The given value is not a list of one of the allowed types '{value}'.")


class ParameterException(Exception):
    """rclpy.exceptions."""

    def __init__(self, text: str, parameters: Any) -> None:
        super().__init__(f"{text}: {parameters}")


class InvalidParameterTypeException(ParameterException):
    def __init__(self, parameter: Parameter, expected: str) -> None:
        super().__init__(
            f"Trying to set parameter '{parameter.name}' to '{parameter.value}' of type "
            f"'{parameter.type_.name}', expecting type '{expected}'",
            parameter.name,
        )


class InvalidParameterValueException(ParameterException):
    def __init__(self, name: str, value: Any, reason: str) -> None:
        super().__init__(f"Invalid parameter value ({value}) for parameter. Reason: {reason}", name)


class ParameterAlreadyDeclaredException(ParameterException):
    pass


class ParameterNotDeclaredException(ParameterException):
    pass


class ParameterImmutableException(ParameterException):
    pass


class Parameter:
    """rclpy.parameter.Parameter."""

    Type = Type

    def __init__(self, name: str, type_: Type | None = None, value: Any = None) -> None:
        self.name, self.value = name, value
        self.type_ = type_ or Type.of(value)


@dataclass
class Range:
    from_value: Any = 0
    to_value: Any = 0
    step: Any = 0


class IntegerRange(Range):
    def __setattr__(self, name: str, value: Any) -> None:
        assert type(value) is int, f"The '{name}' field must be of type 'int'"
        super().__setattr__(name, value)


class FloatingPointRange(Range):
    def __setattr__(self, name: str, value: Any) -> None:
        assert isinstance(value, float) or name == "step", f"The '{name}' field must be a float"
        super().__setattr__(name, value)


@dataclass
class ParameterDescriptor:
    """rcl_interfaces.msg.ParameterDescriptor; of the two ranges at most one may be given."""

    name: str = ""
    type: int = 0
    description: str = ""
    additional_constraints: str = ""
    read_only: bool = False
    dynamic_typing: bool = False
    floating_point_range: list = field(default_factory=list)
    integer_range: list = field(default_factory=list)


@dataclass
class SetParametersResult:
    successful: bool = False
    reason: str = ""


def refusal(parameter, descriptor, check_read_only) -> str:
    """rclpy.node.Node._apply_descriptor."""
    value, kind = parameter.value, parameter.type_
    if check_read_only and descriptor.read_only:
        return f"Trying to set a read-only parameter: {parameter.name}."
    assert not (descriptor.integer_range and descriptor.floating_point_range)
    if descriptor.dynamic_typing:
        descriptor.type = kind.value
    elif kind.value != descriptor.type:
        return f"Wrong parameter type, expected '{Type(descriptor.type)}' got '{kind}'"
    ranges = {Type.INTEGER: descriptor.integer_range, Type.DOUBLE: descriptor.floating_point_range}
    for limits in ranges.get(kind, []):
        ends = (limits.from_value, limits.to_value)
        if not any(math.isclose(value, end) for end in ends) and not ends[0] < value < ends[1]:
            return f"Parameter {parameter.name} out of range Min: {ends[0]}, Max: {ends[1]}"
    return ""
