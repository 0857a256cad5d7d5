"""Scene: everything a user can choose, one frozen tree, read from and written to TOML.

This is the only declaration of an option: its bounds and description serve validation, the
command line's help and the web page's sliders alike.
"""

from __future__ import annotations

import difflib
import os
import sys
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from phy124.boundaries import AnyBoundary, Ground
from phy124.camera import FOV_Y
from phy124.errors import InputError
from phy124.forces import AnyForce, Gravity
from phy124.materials import AnyMaterial, NeoHookean, forget_others
from phy124.region import Region, Vector
from phy124.stiffness import AnyStiffness

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ViewName = Literal["front", "right", "back", "left", "orbit"]
Format = Literal["mp4", "webp", "gif", "png", "usd", "ply"]
Degrees = Annotated[float, Field(ge=-360, le=360)]


class Section(BaseModel):
    """A frozen part of a scene that knows all its keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Object(Section):
    """The object made from the picture and how it stands in the world."""

    size: float = Field(default=1.0, ge=1e-6, le=1e4, description="Longest side [m].")
    lift: float = Field(
        default=0.0, ge=0, le=1e4, description="Height of its lowest point above z = 0 [m]."
    )
    velocity: Vector = Field(default=(0.0, 0.0, 0.0), description="Velocity at the start [m/s].")
    spin: Vector = Field(
        default=(0.0, 0.0, 0.0), description="Angular velocity about its middle [rad/s]."
    )


class Accuracy(Section):
    """What buys accuracy: cells across the object and particles in them."""

    cells: int = Field(default=32, ge=4, le=256, description="Grid cells across the longest side.")
    ppc: float = Field(
        default=2.0, ge=1, le=4, description="Particles per cell and axis inside the object."
    )
    cfl: float = Field(default=0.6, gt=0, le=0.9, description="Share of the stable substep used.")
    precision: Literal["float32", "float64"] = Field(
        default="float32", description="Floating-point precision of the simulation."
    )


PRESETS = {
    "draft": Accuracy(cells=16),
    "standard": Accuracy(cells=32),
    "fine": Accuracy(cells=48, precision="float64"),
}
"""Named accuracies (docs/accuracy.md)."""


@dataclass(frozen=True)
class Promise:
    """What a named accuracy is good for."""

    error: float
    """RMS distance of the Gaussians from the exact motion over a clip, in object sizes."""
    why: str
    """Why it can be promised, and where not."""


PROMISES = {
    "draft": Promise(
        0.07,
        "thin places bend as if they were thicker by a part of a cell, and a cell is 6 % of the "
        "object; for looking at a motion before it is made well",
    ),
    "standard": Promise(
        0.04,
        "cells half as wide bend more truly; a smaller substep would not help, "
        "for what transfers lose per step does not depend on it",
    ),
    "fine": Promise(
        0.03,
        "cells a third as wide, at least two particles per cell and axis so that they are used, "
        "and double precision so that rounding is no question",
    ),
}
"""Measured on the preset scenes; hard bounces lose more (`phy124 accuracy` tells for a scene)."""
AccuracyName = Literal["draft", "standard", "fine"]


class Timing(Section):
    """Which instants are kept."""

    frames: int = Field(default=14, ge=1, le=10_000, description="Number of frames.")
    fps: float = Field(default=24.0, ge=1, le=1000, description="Frames per second of motion.")
    substep: float | None = Field(
        default=None, gt=0, description="Longest substep allowed [s]; absent: as stability needs."
    )
    sleep: bool = Field(
        default=True,
        description="Leave substeps out while the object rests; at most 3e-4 of its size astray.",
    )
    patience: float = Field(
        default=7200.0, gt=0, description="A simulation forecast to take longer is refused [s]."
    )


def _width_and_height(size: Any) -> Any:
    """512, "512", [640, 480] or "640x480" as two sides; what is neither is refused later."""
    sides = size.lower().split("x") if isinstance(size, str) else size
    sides = sides if isinstance(sides, (tuple, list)) else [sides]
    return [*sides, *sides] if len(sides) == 1 else sides


def _shortest(size: tuple[int, int]) -> int | tuple[int, int]:
    return size[0] if size[0] == size[1] else size


Side = Annotated[int, Field(ge=16, le=4096)]
Size = Annotated[
    tuple[Side, Side],
    BeforeValidator(_width_and_height, json_schema_input_type=Side | tuple[Side, Side]),
    PlainSerializer(_shortest),
]
"""Width and height; one number, or text such as 640x480, is taken as well."""


class View(Section):
    """How the clip is filmed."""

    views: tuple[ViewName, ...] = Field(
        default=("front", "right", "back", "left", "orbit"),
        description="Sides to film: front, right, back, left, orbit.",
    )
    azimuths: tuple[Degrees, ...] = Field(
        default=(), description="Sides besides, by angle: 0 is the front, 90 the right [deg]."
    )
    formats: tuple[Format, ...] = Field(
        default=("mp4",),
        description="Of each side a video (mp4, webp, gif) or a folder of pictures (png); "
        "of the whole clip usd, or ply, a folder with a file per frame.",
    )
    size: Size = Field(
        default=(512, 512), description="Width and height, or one number for both [pixels]."
    )
    elevation: float = Field(
        default=10.0, ge=-89, le=89, description="Camera height angle, positive looks down [deg]."
    )
    distance: float = Field(
        default=1.9, ge=0.6, le=100, description="Camera distance, in object sizes."
    )
    follow: bool = Field(
        default=False, description="The camera goes along and keeps what moves in the middle."
    )
    fov: float = Field(default=FOV_Y, ge=1, le=120, description="Vertical field of view [deg].")
    background: tuple[float, float, float] = Field(
        default=(1.0, 1.0, 1.0), description="Background colour, 0..1 each."
    )
    transparent: bool = Field(
        default=False, description="No background: formats webp, png, and gif (all or nothing)."
    )
    fps: float | None = Field(
        default=None, ge=1, le=120, description="Playback rate of the MP4s; absent: real time."
    )

    @model_validator(mode="after")
    def _colour(self) -> View:
        if not all(0 <= channel <= 1 for channel in self.background):
            raise ValueError(f"background {self.background} has a channel outside 0..1; use 0..1")
        return self

    @model_validator(mode="after")
    def _sides(self) -> View:
        if not self.sides or len(set(self.sides)) != len(self.sides):
            raise ValueError("views must name at least one view, or azimuths an angle, each once")
        if not self.formats or len(set(self.formats)) != len(self.formats):
            raise ValueError("formats must name at least one format, each once")
        return self

    @field_validator("transparent")
    @classmethod
    def _can_be(cls, transparent: bool, info: ValidationInfo) -> bool:
        if transparent and "mp4" in info.data.get("formats", ()):
            raise ValueError("an MP4 cannot be transparent; choose the format webp, png or gif")
        return transparent

    @property
    def sides(self) -> tuple[str, ...]:
        """Names of all sides: the views, then such as "azimuth-45"."""
        return (*self.views, *(f"azimuth-{azimuth % 360:g}" for azimuth in self.azimuths))


class Part(Section):
    """A part of the object that is made of another material, or does not move at all."""

    material: AnyMaterial = Field(default_factory=NeoHookean, description="Its material.")
    static: bool = Field(
        default=False, description="Scenery: it is seen, but neither moves nor touches anything."
    )
    region: Region | None = Field(default=None, description="Box of space it lies in [m].")
    mask: str | None = Field(
        default=None, description="Picture file, white where it is seen from the front."
    )
    gaussians: tuple[int, int] | None = Field(
        default=None, description="Its Gaussians: the first and one past the last."
    )

    @model_validator(mode="after")
    def _picked(self) -> Part:
        if self.region is None and self.mask is None and self.gaussians is None:
            raise ValueError("a part needs a region, a mask or gaussians to say where it is")
        if self.static and self.material != NeoHookean():
            raise ValueError("a static part is made of nothing; leave its material out")
        return self

    def data(self) -> dict[str, Any]:
        """How it is picked, as plain data."""
        return self.model_dump(mode="json", exclude_none=True, exclude={"material", "static"})


class Scene(Section):
    """One complete simulation: object, material, forces, boundaries, accuracy, time and view."""

    description: str = Field(default="", description="What happens, in a sentence.")
    seed: int = Field(default=0, ge=0, le=2**31 - 1, description="Seed of everything random.")
    object: Object = Field(default_factory=Object)
    material: AnyMaterial = Field(default_factory=NeoHookean, description="Constitutive law.")
    parts: tuple[Part, ...] = Field(default=(), description="Parts of other materials.")
    stiffness: AnyStiffness | None = Field(
        default=None, description="How E varies inside the object; absent: not at all."
    )
    forces: tuple[AnyForce, ...] = Field(default=(Gravity(),), description="What pushes.")
    boundaries: tuple[AnyBoundary, ...] = Field(default=(Ground(),), description="What is solid.")
    accuracy: AccuracyName | Accuracy = Field(
        default="standard",
        description="draft (error up to 7 % of the object's size), standard (4 %), fine (3 %), "
        "or a table of cells, ppc, cfl and precision.",
    )
    binding: Literal["particles", "field"] = Field(
        default="particles",
        description="particles: every Gaussian is a particle (the paper); field: they ride along.",
    )
    time: Timing = Field(default_factory=Timing)
    velocities: bool = Field(
        default=False,
        description="Keep the velocity of each Gaussian; speeds also follow from the places.",
    )
    view: View = Field(default_factory=View)

    @property
    def resolution(self) -> Accuracy:
        """The accuracy settings, names looked up."""
        return PRESETS[self.accuracy] if isinstance(self.accuracy, str) else self.accuracy

    @property
    def materials(self) -> list[AnyMaterial]:
        """The scene's material, then those of its parts that move."""
        return [self.material, *(part.material for part in self.parts if not part.static)]

    @property
    def dx(self) -> float:
        """Grid spacing [m]."""
        return self.object.size / self.resolution.cells

    @classmethod
    def from_data(cls, data: dict[str, Any], source: str = "scene") -> Scene:
        """Validate plain data; raises InputError naming field, value, limit and remedy."""
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            raise _refusal(error, source) from None

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Scene:
        """Read a scene file; raises InputError."""
        try:
            data = tomllib.loads(Path(path).read_text("utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(
                "scene", path, f"it cannot be read ({error}).", "Give a TOML file or a preset name."
            ) from None
        except tomllib.TOMLDecodeError as error:
            raise InputError(
                "scene", path, f"it is not valid TOML: {error}.", "Correct that line."
            ) from None
        return cls.from_data(data, str(path))

    @classmethod
    def named(cls, name: str) -> Scene:
        """A preset by name, or a scene file by path; raises InputError."""
        if name in preset_names():
            return cls.from_toml(_preset_folder() / f"{name}.toml")
        if Path(name).suffix == ".toml":
            return cls.from_toml(name)
        close = difflib.get_close_matches(name, preset_names(), 1)
        hint = f"Did you mean {close[0]}? " if close else ""
        known = ", ".join(preset_names())
        raise InputError(
            "scene", name, "no preset has that name.", f"{hint}Give a .toml file or one of {known}."
        )

    def data(self) -> dict[str, Any]:
        """The whole tree as plain data; what is None is left out."""
        return self.model_dump(mode="json", exclude_none=True)

    def to_toml(self) -> str:
        """The whole tree as TOML."""
        return tomli_w.dumps(self.data())

    def replaced(self, changes: dict[str, Any]) -> Scene:
        """With other values at dotted paths, such as {"material.E": 2e4}; raises InputError.

        A material of another law forgets what only the former one had.
        """
        data = self.data()
        # Laws come first, so that what is forgotten is not what was just asked for.
        for path in sorted(changes, key=lambda path: not path.endswith("material.law")):
            section = _put(data, path, changes[path])
            if path.endswith("material.law"):
                forget_others(section)
        return Scene.from_data(data)


def preset_names() -> list[str]:
    """Names of the packaged scenes, in alphabetical order."""
    return sorted(path.stem for path in _preset_folder().glob("*.toml"))


def parse_value(text: str) -> Any:
    """A value as TOML writes it; bare words are text."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _preset_folder() -> Path:
    return Path(str(resources.files("phy124") / "presets"))


def _put(data: Any, path: str, value: Any) -> Any:
    """Set one value in nested dicts and lists and return what it lies in; items go by number."""
    *parents, last = path.split(".")
    for key in parents:
        try:
            data = data[int(key)] if isinstance(data, list) else data.setdefault(key, {})
        except (ValueError, IndexError):
            raise InputError(path, value, f"there is no item {key!r}.", "Count from 0.") from None
    try:
        data[int(last) if isinstance(data, list) else last] = value
    except (ValueError, IndexError, TypeError):
        raise InputError(
            path, value, f"there is no {last!r} to set there.", "See scene.toml."
        ) from None
    return data


def _refusal(error: ValidationError, source: str) -> InputError:
    """Pydantic's most deeply located complaint as our sentence."""
    first = max(error.errors(), key=lambda found: len(found["loc"]))
    where = [part for part in first["loc"] if not _is_tag(part)]
    field = ".".join(str(part) for part in where) or source
    kind, value = first["type"], first["input"]
    message = first["msg"].removeprefix("Value error, ").rstrip(".") + "."
    if kind == "extra_forbidden":
        known = _known_keys(where[:-1])
        close = difflib.get_close_matches(str(where[-1]), known, 1)
        if where[-1] in known:
            return InputError(field, value, "this kind has no such key.", "Leave it out.")
        hint = f"Did you mean {close[0]}?" if close else f"Known keys: {', '.join(known)}."
        return InputError(field, value, "there is no such key.", hint)
    remedy = _description(where) or "Change the value."
    return InputError(field, value, message, remedy)


def _is_tag(part: int | str) -> bool:
    """Whether a location is the name of a union's member rather than a key."""
    return isinstance(part, str) and (part in _TAGS or part.startswith(("literal[", "Accuracy")))


def _tags(model: type[BaseModel]) -> set[str]:
    return {
        info.default
        for name, info in model.model_fields.items()
        if name in ("law", "kind") and isinstance(info.default, str)
    }


def _members(annotation: Any) -> list[type[BaseModel]]:
    """All models named in an annotation, however nested."""
    if isinstance(annotation, type):
        return [annotation] if issubclass(annotation, BaseModel) else []
    return [m for part in getattr(annotation, "__args__", ()) for m in _members(part)]


def _models(where: list[int | str]) -> list[type[BaseModel]]:
    """The models a location may lie in."""
    models: list[type[BaseModel]] = [Scene]
    for part in where:
        if isinstance(part, str):
            fields = [m.model_fields[part] for m in models if part in m.model_fields]
            models = [member for info in fields for member in _members(info.annotation)]
    return models


def _known_keys(where: list[int | str]) -> list[str]:
    return sorted({name for model in _models(where) for name in model.model_fields})


def _description(where: list[int | str]) -> str:
    """What the field at a location is, with its unit."""
    while where and isinstance(where[-1], int):
        where = where[:-1]
    for model in _models(where[:-1]) if where else []:
        info = model.model_fields.get(str(where[-1]))
        if info is not None and info.description:
            return f"It is: {info.description}"
    return ""


def _nested(model: type[BaseModel]) -> list[type[BaseModel]]:
    """A model and all models in it."""
    inner = [m for info in model.model_fields.values() for m in _members(info.annotation)]
    return [model, *(found for m in inner for found in _nested(m))]


_TAGS = {tag for model in _nested(Scene) for tag in _tags(model)}
