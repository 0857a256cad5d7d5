"""View: where the camera stands, and the size and formats in which a clip is filmed."""

from __future__ import annotations

import difflib
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    PlainSerializer,
    ValidationInfo,
    field_validator,
    model_validator,
)

from phy124.bounds import Colour, FileName
from phy124.camera import FOV_Y
from phy124.scene.cameras import AnyCamera
from phy124.section import Section

ViewName = Literal["front", "right", "back", "left", "orbit"]
Format = Literal["mp4", "webp", "gif", "png", "usd", "ply"]
StageName = Literal["plain", "studio", "transparent"]
Output = Literal["depth", "alpha", "normals", "flow", "velocity", "force"]
Degrees = Annotated[float, Field(ge=-360, le=360)]


def _named_colour(value: Any) -> Any:
    """The channels of a colour given as a CSS name or as #rrggbb."""
    if not isinstance(value, str):
        return value
    from PIL import ImageColor

    try:
        return tuple(channel / 255 for channel in ImageColor.getrgb(value)[:3])
    except ValueError:
        close = difflib.get_close_matches(value, ImageColor.colormap, 1)
        hint = (
            f"did you mean {close[0]}?" if close else 'write "grey", "#808080" or [0.5, 0.5, 0.5]'
        )
        raise ValueError(f"CSS knows no colour of that name; {hint}") from None


Background = Annotated[tuple[Colour, Colour, Colour], BeforeValidator(_named_colour)]
"""A colour as red, green and blue, 0 to 1."""


def _width_and_height(size: Any) -> Any:
    """Two sides from 512, "512", [640, 480] or "640x480"; anything else is refused later."""
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
"""Width and height in pixels; one number or text such as 640x480 is accepted as well."""


class View(Section):
    """How a clip is filmed."""

    views: tuple[ViewName, ...] = Field(
        default=("front", "right", "back", "left", "orbit"),
        description="Sides to film: front, right, back, left, orbit.",
    )
    azimuths: tuple[Degrees, ...] = Field(
        default=(),
        examples=[[45, 135]],
        description="Sides besides, by angle: 0 is the front, 90 the right [deg].",
    )
    cameras: tuple[AnyCamera, ...] = Field(
        default=(),
        max_length=32,
        description="Cameras that move besides: turntable, dolly or path.",
    )
    formats: tuple[Format, ...] = Field(
        default=("mp4",),
        description="Of each side a video (mp4, webp, gif) or a folder of pictures (png); "
        "of the whole clip usd, or ply, a folder with a file per frame.",
    )
    outputs: tuple[Output, ...] = Field(
        default=(),
        examples=[["depth", "flow"]],
        description="Quantities of each pixel besides its colour, for training data: depth [m], "
        "alpha, normals, flow [px/frame], velocity [m/s], force of the walls [N/px].",
    )
    output_format: Literal["png", "exr"] = Field(
        default="png", description="Of outputs: png, 16 bits, or exr, 32-bit floats."
    )
    size: Size = Field(
        default=(512, 512), description="Width and height, or one number for both [pixels]."
    )
    elevation: float = Field(
        default=10.0, ge=-89, le=89, description="Camera height angle, positive looks down [deg]."
    )
    distance: float = Field(
        default=1.9,
        ge=0.6,
        le=100,
        description="Camera distance, in object sizes; the default is any that fit finds.",
    )
    fit: bool = Field(
        default=True,
        description="Stand as near as shows the whole motion; not with a distance of one's own.",
    )
    follow: bool | None = Field(
        default=None,
        examples=[False],
        description="The camera goes along and keeps what moves in the middle; absent: if a still "
        "one that fits the whole motion would show most of it too small.",
    )
    fov: float = Field(default=FOV_Y, ge=1, le=120, description="Vertical field of view [deg].")
    filter: Literal["dilate", "mip"] = Field(
        default="dilate",
        description="What keeps splats from falling between pixels: dilate widens them, as 3D "
        "Gaussian Splatting does; mip also makes them fainter, as Mip-Splatting does, so that thin "
        "things do not grow thicker in small pictures.",
    )
    shine: bool = Field(
        default=True,
        description="Light what is fluid or metal by the normals of its surface: highlights and "
        "reflections; off: the colours that its Gaussians have.",
    )
    stage: StageName = Field(
        default="plain",
        description="plain: the object before the background; studio: on a floor with its shadow, "
        "among the scene's boundaries; transparent: nothing behind it, in the formats webp, png "
        "and gif (all or nothing).",
    )
    background: Background = Field(
        default=(1.0, 1.0, 1.0),
        description="Background colour: red, green and blue from 0 to 1, or a CSS name.",
    )
    gradient: Background | None = Field(
        default=None,
        examples=["whitesmoke"],
        description="Colour at the bottom into which the background goes over; absent: one colour.",
    )
    picture: FileName | None = Field(
        default=None,
        examples=["beach.jpg"],
        description="Picture that fills the background instead; absent: the colour.",
    )
    fps: float | None = Field(
        default=None,
        ge=1,
        le=120,
        examples=[12],
        description="Pictures per second of the videos; absent: those of the motion times speed.",
    )
    speed: float = Field(
        default=1.0,
        ge=1e-3,
        le=100,
        description="Playback speed: 1 is real time, 0.25 slow motion, four times as long.",
    )

    @model_validator(mode="after")
    def _sides(self) -> View:
        if not self.sides or len(set(self.sides)) != len(self.sides):
            raise ValueError(
                "views must name at least one view, or azimuths an angle, each once, and cameras "
                "have other names; name each once"
            )
        if not (self.formats or self.outputs) or len(set(self.formats)) != len(self.formats):
            raise ValueError("formats must name at least one format, each once; name each once")
        if len(set(self.outputs)) != len(self.outputs):
            raise ValueError("outputs must name each output once; leave the second one out")
        return self

    @field_validator("stage")
    @classmethod
    def _can_be(cls, stage: StageName, info: ValidationInfo) -> StageName:
        if stage == "transparent" and "mp4" in info.data.get("formats", ()):
            raise ValueError("an MP4 cannot be transparent; choose the format webp, png or gif")
        return stage

    @field_validator("speed")
    @classmethod
    def _alone(cls, speed: float, info: ValidationInfo) -> float:
        if speed != 1 and info.data.get("fps") is not None:
            raise ValueError("fps and speed both say how fast it plays; give one of the two")
        return speed

    @property
    def sides(self) -> tuple[str, ...]:
        """Names of all sides to film: the named views, names such as "azimuth-45", the cameras'."""
        angles = (f"azimuth-{azimuth % 360:g}" for azimuth in self.azimuths)
        return (*self.views, *angles, *(camera.name for camera in self.cameras))

    @property
    def fits(self) -> bool:
        """Whether the camera stands as near as shows the whole motion: no distance was chosen."""
        return self.fit and self.distance == View.model_fields["distance"].default

    def camera(self, side: str) -> AnyCamera | None:
        """The camera of this name; None if the side is none of the cameras."""
        return next((camera for camera in self.cameras if camera.name == side), None)

    def only(self, side: str) -> View:
        """The view from one of its sides."""
        camera = self.camera(side)
        views = tuple(name for name in self.views if name == side)
        angle = () if views or camera else (float(side.removeprefix("azimuth-")),)
        return self.model_copy(
            update={"views": views, "azimuths": angle, "cameras": (camera,) if camera else ()}
        )
