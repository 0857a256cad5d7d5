"""The sections of a scene other than its view: the object, its parts, the timing, the checks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from phy124.bounds import FileName, Name, Spot, Velocity
from phy124.materials import AnyMaterial, NeoHookean
from phy124.region import PartRegion
from phy124.section import Section

Number = Annotated[int, Field(ge=0, le=10_000_000)]
"""The index of a Gaussian."""
Seconds = Annotated[float, Field(ge=1e-3, le=1e4)]
Rate = Annotated[float, Field(ge=1, le=1000)]
LENGTH = TypeAdapter(tuple[Seconds, Rate])
"""A length of time [s] and frames per second."""
FLOOR = "floor"
"""What an object stands on that stands on no other one."""
_Degrees = Annotated[float, Field(ge=-360, le=360)]
Angles = tuple[_Degrees, _Degrees, _Degrees]


def _is(default: Any) -> Callable[[Any], bool]:
    """Whether a value says nothing, so that scenes of one object are written as ever."""
    return lambda value: value == default


class Object(Section):
    """The object made from the picture, and how it is placed in the world."""

    size: float = Field(default=1.0, ge=1e-6, le=1e4, description="Longest side [m].")
    lift: float = Field(
        default=0.0, ge=0, le=1e4, description="Height of its lowest point above z = 0 [m]."
    )
    velocity: Velocity = Field(default=(0.0, 0.0, 0.0), description="Velocity at the start [m/s].")
    spin: Velocity = Field(
        default=(0.0, 0.0, 0.0), description="Angular velocity about its middle [rad/s]."
    )
    name: Name = Field(
        default="object", exclude_if=_is("object"), description="What the scene calls it."
    )
    place: Spot = Field(
        default=(0.0, 0.0),
        exclude_if=_is((0.0, 0.0)),
        description="Where its middle stands on the floor, x and y [m].",
    )
    turn: Angles = Field(
        default=(0.0, 0.0, 0.0),
        exclude_if=_is((0.0, 0.0, 0.0)),
        description="How far it is turned about x, then y, then z [degrees].",
    )
    on: Name = Field(
        default=FLOOR,
        exclude_if=_is(FLOOR),
        description="What it stands on, from which `lift` counts: the floor at z = 0, or the name "
        "of another object, which it then touches.",
    )
    held: bool = Field(
        default=False,
        exclude_if=_is(False),
        description="It never moves; other objects meet it as they meet a wall.",
    )


class Timing(Section):
    """Which instants are kept as frames, and how long a run may take."""

    frames: int = Field(default=14, ge=1, le=10_000, description="Number of frames.")
    fps: Rate = Field(default=24.0, description="Frames per second of motion.")
    seconds: Seconds | None = Field(
        default=None,
        examples=[3],
        description="Length of the motion [s], instead of frames, which are then seconds x fps.",
    )
    substep: float | None = Field(
        default=None,
        ge=1e-9,
        le=1,
        examples=[1e-4],
        description="Longest substep allowed [s]; absent: as stability needs.",
    )
    sleep: bool = Field(
        default=True,
        description="Leave substeps out while the object rests; at most 3e-4 of its size astray.",
    )
    budget: float = Field(
        default=7200.0,
        ge=1e-3,
        le=1e8,
        description="Longest time of a simulation [s]; one predicted to take longer is refused, "
        "and it stops at twice that, in processor time of its busiest thread.",
    )

    @model_validator(mode="before")
    @classmethod
    def _counted(cls, data: Any) -> Any:
        """Frames in place of seconds, so that a scene says in one way how long it is."""
        if not isinstance(data, dict) or data.get("seconds") is None:
            return data
        if "frames" in data:
            raise ValueError("frames and seconds both say how long it is; give one of the two")
        try:
            rate = data.get("fps", cls.model_fields["fps"].default)
            seconds, fps = LENGTH.validate_python((data["seconds"], rate))
        except ValidationError:
            return data  # the fields refuse it
        rest = {name: value for name, value in data.items() if name != "seconds"}
        return {**rest, "frames": max(1, round(seconds * fps))}

    @property
    def length(self) -> float:
        """How long the motion is, each frame counted for 1 / fps [s]."""
        return self.frames / self.fps


class Checks(Section):
    """How closely a run is watched. Each check costs time and guards against a kind of failure."""

    measure: int = Field(
        default=16,
        ge=1,
        le=32,
        description="Substeps between two measurements of what limits them; above 4 only while "
        "nothing can be strained, by a wall or otherwise, until it is much stiffer.",
    )
    balance: bool = Field(
        default=True,
        description="Add up what forces and walls give, so that energy or momentum from nowhere "
        "stops the run; without it only broken numbers and particles inside out do.",
    )
    energy: bool = Field(
        default=False,
        exclude_if=_is(False),
        description="Report where the energy lost has gone: to the material, to friction at walls, "
        "to the numerics.",
    )


def check_energy(checks: Checks, beyond: dict[str, bool]) -> None:
    """Refuse to split the energy lost where a part of it is not measured.

    Args:
        checks: What is asked for.
        beyond: Whether a scene has what the split does not cover, by name.

    Raises:
        ValueError: The split is asked for and cannot be made.
    """
    if not checks.energy:
        return
    if not checks.balance:
        raise ValueError("checks.energy needs checks.balance; leave one out or set the other")
    for name, present in beyond.items():
        if present:
            raise ValueError(
                f"checks.energy cannot tell what is lost in a scene with {name}; leave one of the "
                "two out"
            )


class Part(Section):
    """A part of the object that is made of another material, or does not move at all."""

    material: AnyMaterial = Field(default=NeoHookean(), description="Its material.")
    static: bool = Field(
        default=False, description="Scenery: it is seen, but neither moves nor touches anything."
    )
    surroundings: bool = Field(
        default=False,
        description="Static Gaussians, such as a floor, that do not count for the object's size.",
    )
    region: PartRegion | None = Field(default=None, description="Box of space it lies in [m].")
    mask: FileName | None = Field(
        default=None,
        examples=["hat.png"],
        description="Picture file, white where it is seen from the front.",
    )
    gaussians: tuple[Number, Number] | None = Field(
        default=None,
        examples=[[0, 2000]],
        description="Its Gaussians: the first and one past the last.",
    )

    @model_validator(mode="after")
    def _picked(self) -> Part:
        if self.region is None and self.mask is None and self.gaussians is None:
            raise ValueError(
                "a part needs a region, a mask or gaussians to say where it is; give one of them"
            )
        if self.static and self.material != NeoHookean():
            raise ValueError("a static part is made of nothing; leave its material out")
        if self.surroundings and (not self.static or self.gaussians is None or self.region):
            raise ValueError(
                "surroundings are static and picked by gaussians alone; set static, and leave "
                "region and mask out"
            )
        return self

    def data(self) -> dict[str, Any]:
        """How the part is selected, as plain data."""
        return self.model_dump(
            mode="json", exclude_none=True, exclude={"material", "static", "surroundings"}
        )
