"""Sections of a scene except the view."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from phy124.errors import InputError
from phy124.materials import AnyMaterial, NeoHookean
from phy124.schema.bounds import FileName, Name, Spot, Velocity
from phy124.schema.region import PartRegion
from phy124.schema.section import Section, omit_default

Number = Annotated[int, Field(ge=0, le=10_000_000)]
Seconds = Annotated[float, Field(ge=1e-3, le=1e4)]
Rate = Annotated[float, Field(ge=1, le=1000)]
MOST_FRAMES = 10_000
LENGTH = TypeAdapter(tuple[Seconds, Rate])
"""Validates the length of a motion [s] and the frames per second."""
FLOOR = "floor"
"""An object stands on the floor unless it stands on another object."""
_Degrees = Annotated[float, Field(ge=-360, le=360)]
Angles = tuple[_Degrees, _Degrees, _Degrees]


class Object(Section):
    """The object made from the picture, and its placement in the world."""

    size: float = Field(default=1.0, ge=1e-6, le=1e4)
    """Length of the object's longest side [m]."""
    lift: float = Field(default=0.0, ge=0, le=1e4)
    """Height of the object's lowest point above z = 0 [m]."""
    velocity: Velocity = (0.0, 0.0, 0.0)
    """Velocity at the start [m/s]."""
    spin: Velocity = (0.0, 0.0, 0.0)
    """Angular velocity about the object's centre [rad/s]."""
    name: Name = omit_default("object")
    """Name of the object."""
    place: Spot = omit_default((0.0, 0.0))
    """Position of the object's centre on the floor, x and y [m]."""
    turn: Angles = omit_default((0.0, 0.0, 0.0))
    """Rotation about x, then y, then z [degrees]."""
    on: Name = omit_default(FLOOR)
    """What the object stands on: the floor at z = 0, or the name of another object. `lift` is the
    gap between this object and what it stands on.
    """
    held: bool = omit_default(False)
    """The object never moves, and acts on other objects like a wall."""
    inside: Literal["auto", "solid", "shell"] = omit_default("auto")
    """auto (shells are filled, vessels and cages remain hollow), solid (every cavity is filled), or
    shell (only gaps between close walls are filled).
    """

    @property
    def scenery(self) -> bool:
        """Whether the object has no particles."""
        return False


class Timing(Section):
    """Number and rate of the stored frames, and limits on the substep and the computing time."""

    frames: int = Field(default=14, ge=1, le=MOST_FRAMES)
    """Number of frames."""
    fps: Rate = 24.0
    """Frames per second of motion."""
    seconds: Seconds | None = Field(default=None, examples=[3])
    """Length of the motion [s], from which frames = seconds x fps is computed."""
    substep: float | None = Field(default=None, ge=1e-9, le=1, examples=[1e-4])
    """Longest substep allowed [s]; if absent, only stability limits the substep."""
    sleep: bool = True
    """Skip substeps while the object rests; this changes positions by at most 3e-4 of its size."""
    budget: float = Field(default=7200.0, ge=1e-3, le=1e8)
    """Maximum computing time [s]. A simulation whose predicted time is longer is refused. A running
    simulation is stopped when its busiest thread has used twice this time.
    """

    @property
    def ceiling(self) -> float:
        """Longest substep allowed [s]; infinity: only stability limits the substep."""
        return math.inf if self.substep is None else self.substep

    @model_validator(mode="before")
    @classmethod
    def _replace_seconds(cls, data: Any) -> Any:
        if not isinstance(data, dict) or data.get("seconds") is None:
            return data
        if "frames" in data:
            raise ValueError("frames and seconds both set the length; give one of the two")
        try:
            rate = data.get("fps", cls.model_fields["fps"].default)
            seconds, fps = LENGTH.validate_python((data["seconds"], rate))
        except ValidationError:
            return data  # the validation of the fields reports this error
        frames = max(1, round(seconds * fps))
        if frames > MOST_FRAMES:
            limit = (
                f"with {fps:g} frames per second, it makes {frames:,} frames instead of at most "
            )
            remedy = f"Set time.seconds to at most {MOST_FRAMES / fps:g}, or reduce time.fps."
            raise InputError("time.seconds", seconds, f"{limit}{MOST_FRAMES:,}.", remedy)
        rest = {name: value for name, value in data.items() if name != "seconds"}
        return {**rest, "frames": frames}

    @property
    def length(self) -> float:
        """Length of the motion [s]; each frame adds 1 / fps."""
        return self.frames / self.fps


class Checks(Section):
    """Monitoring of a run. Each check costs time and detects one kind of failure."""

    measure: int = Field(default=16, ge=1, le=32)
    """Maximum number of substeps between two measurements of the stable limit. This number is at
    most 4 if a particle may stiffen much before the next measurement.
    """
    balance: bool = True
    """Stop the run if the changes of energy and momentum differ from the work and the impulse of
    forces and walls. If off, only non-finite values and inverted particles stop the run.
    """
    energy: bool = omit_default(False)
    """Report the energy lost in the material, in contact, and by the numerical method; on lattices
    and in liquids, report also the work of each cause.
    """


def check_energy(checks: Checks, unsupported: dict[str, bool]) -> None:
    """Refuse `checks.energy` if part of the energy would not be measured.

    The keys of `unsupported` are the features whose energy is not measured. The values state
    whether the scene has the feature.

    Raises:
        InputError: `checks.energy` is on and the scene has such a feature.
    """
    if not checks.energy:
        return
    if not checks.balance:
        limit = "it needs checks.balance, which is off."
        raise InputError("checks.energy", "true", limit, "Remove one of the two settings.")
    for name, present in unsupported.items():
        if present:
            limit = f"it does not support {name.removesuffix('.')}."
            raise InputError("checks.energy", "true", limit, "Remove one of the two settings.")


class Part(Section):
    """A part of the object that has another material, or is static."""

    material: AnyMaterial = NeoHookean()
    """Its material."""
    static: bool = False
    """Scenery: the part is visible, but does not move or touch anything."""
    surroundings: bool = False
    """The part is surroundings, such as a floor: it is static and does not affect the object's
    size.
    """
    region: PartRegion | None = None
    """Box that contains the part [m]."""
    mask: FileName | None = Field(default=None, examples=["hat.png"])
    """Mask file, which is white where the part is visible from the front."""
    gaussians: tuple[Number, Number] | None = Field(default=None, examples=[[0, 2000]])
    """Range of the part's Gaussians: index of the first, and index after the last."""

    @model_validator(mode="after")
    def _check_selection(self) -> Part:
        if self.region is None and self.mask is None and self.gaussians is None:
            raise ValueError("a part needs a region, a mask or gaussians; give one of them")
        if self.static and self.material != NeoHookean():
            raise ValueError("a static part has no material; remove it")
        if self.surroundings and (not self.static or self.gaussians is None or self.region):
            raise ValueError(
                "surroundings must be static and selected by gaussians alone; set static, and "
                "remove region and mask"
            )
        return self

    def data(self) -> dict[str, Any]:
        """Return the selection of the part as plain data."""
        return self.model_dump(
            mode="json", exclude_none=True, exclude={"material", "static", "surroundings"}
        )
