"""The options as ROS parameters of a node; four of them can be changed while the node runs.

All parameters are declared with dynamic typing, because `-p speed:=2` is an integer in ROS but a
float in the bridge. The node stores the float. A value of the wrong type is refused with an error
message, both at the start and by `ros2 param set`.
"""

# rclpy comes with ROS 2 and is in no package index, so type checkers do not find it.
# pyright: reportMissingImports=false

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar, get_args

from pydantic.fields import FieldInfo

from phy124.errors import InputError
from phy124.generators.extras import DepthMap, OtherViews
from phy124.generators.options import GeneratorOptions
from phy124.generators.ply_file import Reading
from phy124.imaging.cutting import Cutting
from phy124.runtime.device import CHOICES
from phy124.schema.section import Section

from .options import LIVE_POINTS, LIVE_PROFILE, Options
from .player import RATES, SPEEDS

Made = TypeVar("Made", bound=Section)
POINTS = (0, 10_000_000)


@dataclass(frozen=True)
class Parameter:
    """A parameter of a node."""

    default: Any
    """Default value, which sets the type; a list means strings, a tuple means floats."""
    description: str
    limits: tuple[float, float] | None = None
    while_running: bool = False
    """Whether the parameter can be changed while the node runs."""


RUNNING = {
    "speed": Parameter(
        1.0, "Playback speed: seconds of the clip per real second.", SPEEDS, while_running=True
    ),
    "rate": Parameter(
        0.0,
        "Largest number of frames per second; 0 means that every frame is sent.",
        (0.0, RATES[1]),
        while_running=True,
    ),
    "loop": Parameter(True, "Start again after the last frame.", while_running=True),
    "max_points": Parameter(
        LIVE_POINTS,
        "Largest number of points per frame, evenly selected; 0 means the default.",
        POINTS,
        while_running=True,
    ),
}
"""Parameters that can be changed while the node runs. Changes take effect immediately."""
RUNNING_LIVE = {name: RUNNING[name] for name in ("speed", "max_points")}
MAKING: dict[str, Any] = {
    "reading": Reading,
    "effort": GeneratorOptions,
    "cutting": Cutting,
    "depth": DepthMap,
    "views": OtherViews,
}
"""Sections of options for making Gaussians, by their names in `LiveOptions`. Each field of these
sections is a parameter.
"""


def _start(field: FieldInfo) -> Any:
    """Return the initial value of a field's parameter; ROS has no None, so 0 or "" means None."""
    if field.default is None:
        kinds = get_args(field.annotation)
        return 0 if int in kinds else 0.0 if float in kinds else ""
    return field.default


CLOCK = {"clock": Parameter(False, "Publish /clock at 40 Hz; no other node must publish it then.")}
CLIP = {"clip": Parameter("", "A clip.safetensors made by phy124."), **CLOCK}
SIMULATED = {
    "source": Parameter("", "A picture or a file of Gaussians."),
    "scene": Parameter("press", "Preset (see `phy124 scenes`) or path of a .toml file."),
    "set": Parameter([""], "Other values of the scene, as KEY=VALUE."),
    "more": Parameter([""], "Pictures, or files of Gaussians, of the scene's further objects."),
    "generator": Parameter("relief", "How a picture becomes Gaussians."),
    "device": Parameter("auto", CHOICES),
    **{
        name: Parameter(_start(field), field.description or "")
        for section in MAKING.values()
        for name, field in section.model_fields.items()
    },
    **CLOCK,
}


def section_of(chosen: dict[str, Any], section: type[Made]) -> Made:
    """Remove the values of a section's fields from `chosen`, and return the section."""
    values = {name: chosen.pop(name) for name in section.model_fields}
    return section(**{name: value for name, value in values.items() if value not in ("", 0)})


TEXTS = {"views": [""], "images": ["rgb", "depth"]}


def message_options() -> dict[str, Parameter]:
    """Return the parameters for the message options, except max_points, which is in `RUNNING`."""
    absent = {"epoch": 0.0, "profile": LIVE_PROFILE, "cameras": "", "draco": 0}
    fields = {n: field for n, field in Options.model_fields.items() if n not in RUNNING}
    return {
        name: Parameter(
            # ROS parameters cannot be None, so another value means None.
            absent[name] if field.default is None else TEXTS.get(name, field.default),
            field.description or "",
        )
        for name, field in fields.items()
    }


def declare(
    node: Any, parameters: Mapping[str, Parameter], *, fixed: bool = True
) -> dict[str, Any]:
    """Declare parameters and return their values; raise InputError if a value is invalid.

    Args:
        node: The node that gets the parameters.
        parameters: The parameters by name.
        fixed: Whether parameters that cannot change while the node runs are declared as read-only.
    """
    from rcl_interfaces.msg import ParameterDescriptor
    from rclpy.parameter import Parameter as RosParameter

    values = {}
    for name, parameter in parameters.items():
        default = parameter.default
        start = list(default) if isinstance(default, tuple) else default
        # Limits are set after the declaration, so that the bridge, not ROS, reports invalid values.
        value = node.declare_parameter(name, start, ParameterDescriptor(dynamic_typing=True)).value
        values[name] = convert(name, value, parameter)
        if isinstance(default, (float, tuple)):
            kept = list(values[name]) if isinstance(default, tuple) else values[name]
            node.set_parameters([RosParameter(name, value=kept)])
        node.set_descriptor(name, descriptor(parameter, fixed=fixed))
    return values


def descriptor(parameter: Parameter, *, fixed: bool = True) -> Any:
    """Describe a parameter, for `ros2 param describe`."""
    from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

    about = ParameterDescriptor(
        description=parameter.description,
        read_only=fixed and not parameter.while_running,
        dynamic_typing=True,
    )
    if parameter.limits:
        minimum, maximum = parameter.limits
        about.additional_constraints = f"from {minimum:g} to {maximum:g}"
        if isinstance(parameter.default, int):
            about.integer_range = [IntegerRange(from_value=int(minimum), to_value=int(maximum))]
        else:
            about.floating_point_range = [
                FloatingPointRange(from_value=float(minimum), to_value=float(maximum))
            ]
    return about


def convert(name: str, value: Any, parameter: Parameter) -> Any:
    """Convert the ROS value of the parameter `name` to the type of its default.

    Raises:
        InputError: The value has another type, or is out of range.
    """
    kind, read = KINDS[type(parameter.default)]
    wanted = read(value)
    if wanted is None:
        limit = f"It takes {kind}."
        remedy = f"For example `-p {name}:={_example(parameter.default)}`."
        raise InputError(name, value, limit, remedy)
    minimum, maximum = parameter.limits or (-math.inf, math.inf)
    if parameter.limits and not minimum <= wanted <= maximum:
        limit = f"It must lie between {minimum:g} and {maximum:g}."
        remedy = f"The default is {_example(parameter.default)}."
        raise InputError(name, value, limit, remedy)
    return wanted


class Running:
    """Parameters that can be changed during playback and show the state of playback."""

    def __init__(
        self, node: Any, parameters: Mapping[str, Parameter], apply: Callable[[str, Any], None]
    ) -> None:
        """Watch declared parameters; `apply(name, value)` carries out a change."""
        self._node, self._parameters, self._apply = node, parameters, apply
        node.add_pre_set_parameters_callback(self._keep_types)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._carry_out)

    def close(self) -> None:
        """Stop watching changes of the parameters."""
        self._node.remove_pre_set_parameters_callback(self._keep_types)
        self._node.remove_on_set_parameters_callback(self._check)
        self._node.remove_post_set_parameters_callback(self._carry_out)

    def follow(self, values: Mapping[str, Any]) -> None:
        """Set the node's parameters to the values that a command has changed."""
        from rclpy.parameter import Parameter as RosParameter

        for name in values.keys() & self._parameters.keys():
            if self._node.get_parameter(name).value != values[name]:
                self._node.set_parameters([RosParameter(name, value=values[name])])

    def _keep_types(self, asked: list[Any]) -> list[Any]:
        from rclpy.parameter import Parameter as RosParameter

        kept = []
        for parameter in asked:
            known = self._parameters.get(parameter.name)
            with suppress(InputError):
                if known is not None:
                    value = convert(parameter.name, parameter.value, known)
                    parameter = RosParameter(parameter.name, value=value)
            kept.append(parameter)
        return kept

    def _check(self, asked: list[Any]) -> Any:
        from rcl_interfaces.msg import SetParametersResult

        try:
            for _ in self._ours(asked):
                pass
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _carry_out(self, done: list[Any]) -> None:
        for name, value in self._ours(done):
            self._apply(name, value)

    def _ours(self, some: list[Any]) -> Iterator[tuple[str, Any]]:
        for parameter in some:
            known = self._parameters.get(parameter.name)
            if known is not None:
                yield parameter.name, convert(parameter.name, parameter.value, known)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _whole(value: Any) -> int | None:
    return int(value) if _is_number(value) and value % 1 == 0 else None


def _numbers(value: Any) -> tuple[float, ...] | None:
    # rclpy returns arrays for lists of numbers.
    listed = isinstance(value, (list, tuple, array))
    return tuple(map(float, value)) if listed and all(map(_is_number, value)) else None


def _texts(value: Any) -> tuple[str, ...] | None:
    texts = isinstance(value, (list, tuple)) and all(isinstance(text, str) for text in value)
    return tuple(filter(None, value)) if texts else None


KINDS: dict[type, tuple[str, Callable[[Any], Any]]] = {
    bool: ("true or false", lambda value: value if isinstance(value, bool) else None),
    str: ("a text", lambda value: value if isinstance(value, str) else None),
    float: ("a number", lambda value: float(value) if _is_number(value) else None),
    int: ("a whole number", _whole),
    tuple: ("a list of numbers", _numbers),
    list: ("a list of texts", _texts),
}
"""For each type, its name in messages and a conversion function. The function returns None for
values of another type.
"""


def _example(default: Any) -> str:
    if isinstance(default, (tuple, list)):
        return f"[{', '.join(map(str, default)) or 'KEY=VALUE'}]"
    return (
        str(default).lower()
        if isinstance(default, bool)
        else "TEXT"
        if default == ""
        else str(default)
    )
