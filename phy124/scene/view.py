"""View: cameras, picture size, formats and stage of videos."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    PlainSerializer,
    ValidationInfo,
    field_validator,
    model_validator,
)

from phy124.camera import FOV_Y
from phy124.scene.cameras import AnyCamera
from phy124.schema.bounds import RGB, FileName
from phy124.schema.section import Section

ViewName = Literal["front", "right", "back", "left", "orbit"]
Format = Literal["mp4", "webm", "mov", "webp", "gif", "png", "usd", "ply", "html"]
StageName = Literal["plain", "studio", "transparent"]
Output = Literal["depth", "alpha", "normals", "flow", "velocity", "force"]
Degrees = Annotated[float, Field(ge=-360, le=360)]


def _width_and_height(size: Any) -> Any:
    """Convert 512, "512", [640, 480] or "640x480" to two numbers.

    Raises:
        ValueError: A text is neither a number nor two numbers.
    """
    if isinstance(size, str) and not re.fullmatch(r"\s*\d+\s*(x\s*\d+\s*)?", size.lower()):
        raise ValueError("it must be a number or WIDTHxHEIGHT in pixels, such as 512 or 640x480.")
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
"""Width and height in pixels; a single number or text such as 640x480 is accepted as well."""


class View(Section):
    """Options for rendering a clip."""

    views: tuple[ViewName, ...] = ("front", "right", "back", "left", "orbit")
    """Views to film: front, right, back, left, orbit."""
    azimuths: tuple[Degrees, ...] = Field(default=(), examples=[[45, 135]])
    """Additional views by their azimuth: 0 is the front, 90 the right [deg]."""
    cameras: tuple[AnyCamera, ...] = Field(default=(), max_length=32)
    """Additional, moving cameras: turntable, dolly or path."""
    formats: tuple[Format, ...] = ("mp4",)
    """File formats. For each view: a video (mp4, webm, mov, webp, gif) or a folder of pictures
    (png). For the whole clip: usd, ply (a folder with a file per frame), or html (a page that plays
    the motion in 3D). `phy124 export` writes others.
    """
    outputs: tuple[Output, ...] = Field(default=(), examples=[["depth", "flow"]])
    """Quantities per pixel in addition to colour, for training data: depth [m], alpha, normals,
    flow [px/frame], velocity [m/s], force of the walls [N/px].
    """
    output_format: Literal["png", "exr"] = "png"
    """File format of outputs: png (16 bits) or exr (32-bit floats)."""
    size: Size = (512, 512)
    """Width and height, or one number for both [pixels]."""
    elevation: float = Field(default=10.0, ge=-89, le=89)
    """Elevation of the camera [deg]. If the elevation is positive, the camera looks down."""
    distance: float = Field(default=1.9, ge=0.6, le=100)
    """Camera distance, in object sizes; the default lets `fit` choose the distance."""
    fit: bool = True
    """Choose the smallest distance that shows the whole motion; ignored if distance is set."""
    follow: bool | None = Field(default=None, examples=[False])
    """Let the camera follow the object and keep it in the centre. If absent, the camera follows the
    object only if the object would be too small in a view of the whole motion.
    """
    fov: float = Field(default=FOV_Y, ge=1, le=120)
    """Vertical field of view [deg]."""
    filter: Literal["dilate", "mip"] = "dilate"
    """Low-pass filter for splats smaller than a pixel. dilate widens the splats, as 3D Gaussian
    Splatting does; mip also reduces their opacity, as Mip-Splatting does, so that thin parts do not
    look too thick in small pictures.
    """
    shine: bool = True
    """Shade fluids and metal by their surface normals, with highlights and reflections; if off, the
    Gaussians have their plain colours.
    """
    stage: StageName = "plain"
    """plain: the object in front of the background; studio: on a floor with its shadow and the
    scene's boundaries; transparent: no background, for the formats webm, mov, webp, png and gif (in
    gif, pixels are opaque or fully transparent).
    """
    background: RGB = (1.0, 1.0, 1.0)
    """RGB colour: red, green and blue from 0 to 1, or a CSS name."""
    gradient: RGB | None = Field(default=None, examples=["whitesmoke"])
    """Colour at the bottom of a vertical gradient; if absent, the background is uniform."""
    picture: FileName | None = Field(default=None, examples=["beach.jpg"])
    """Picture that fills the background; if absent, the background colour is used."""
    fps: float | None = Field(default=None, ge=1, le=120, examples=[12])
    """Frames per second of the videos; if absent, time.fps times speed."""
    speed: float = Field(default=1.0, ge=1e-3, le=100)
    """Playback speed: 1 is real time; 0.25 is slow motion that takes four times as long."""

    seamless: bool = False
    """Make videos that repeat without a jump. If the object nearly returns to its first pose, the
    last pictures fade into the first pictures. If the object does not return, the motion runs
    forwards and then backwards.
    """
    megabytes: float | None = Field(default=None, gt=0, le=1000, examples=[2.0])
    """Largest size of a gif or webp [MB]: pictures are reduced until it fits."""

    @model_validator(mode="after")
    def _check_names(self) -> View:
        if not self.sides or len(set(self.sides)) != len(self.sides):
            raise ValueError(
                "there must be at least one view, azimuth or camera, and "
                "their names must differ; name each once"
            )
        if not (self.formats or self.outputs):
            raise ValueError(
                "without formats and outputs, no file would be written; "
                "name a format such as mp4, or an output, such as --outputs depth"
            )
        if len(set(self.formats)) != len(self.formats):
            raise ValueError("formats names a format twice; name each once")
        if len(set(self.outputs)) != len(self.outputs):
            raise ValueError("outputs names an output twice; name each once")
        return self

    @field_validator("stage")
    @classmethod
    def _check_stage(cls, stage: StageName, info: ValidationInfo) -> StageName:
        if stage == "transparent" and "mp4" in info.data.get("formats", ()):
            raise ValueError(
                "an MP4 cannot be transparent; choose the format webm, mov, webp, png or gif"
            )
        return stage

    @field_validator("speed")
    @classmethod
    def _check_speed(cls, speed: float, info: ValidationInfo) -> float:
        if speed != 1 and info.data.get("fps") is not None:
            raise ValueError("fps and speed both set the playback rate; give one of the two")
        return speed

    @property
    def sides(self) -> tuple[str, ...]:
        """Names of views, azimuths such as "azimuth-45", and cameras."""
        angles = (f"azimuth-{azimuth % 360:g}" for azimuth in self.azimuths)
        return (*self.views, *angles, *(camera.name for camera in self.cameras))

    @property
    def fits(self) -> bool:
        """Whether the camera's distance is chosen to show the whole motion."""
        return self.fit and self.distance == View.model_fields["distance"].default

    def camera(self, side: str) -> AnyCamera | None:
        """Return the moving camera with this name; None: a fixed view."""
        return next((camera for camera in self.cameras if camera.name == side), None)

    def count_pictures(self, frames: int) -> int:
        """Return the largest number of pictures of a video of a clip with `frames` frames."""
        return 2 * frames - 2 if self.seamless and frames > 2 else frames

    def only(self, side: str) -> View:
        """Return these options with only one view."""
        camera = self.camera(side)
        views = tuple(name for name in self.views if name == side)
        angle = () if views or camera else (float(side.removeprefix("azimuth-")),)
        return self.model_copy(
            update={"views": views, "azimuths": angle, "cameras": (camera,) if camera else ()}
        )
