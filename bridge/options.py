"""Options of the messages, each declared once for code, command line and ROS."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Literal

from pydantic import Field, field_validator, model_validator

from phy124.schema.section import Section

from .layout import Profile

LIVE_PROFILE: Profile = "viz"
LIVE_POINTS = 32_768
"""Gaussians per frame that subscribers receive at 30 Hz (docs/guide/ros2-messages.md)."""
LIVE_SPLATS = 8_192
"""Largest number of Gaussians per frame in the profile `splats`; each Gaussian takes 384 bytes."""
Image = Literal["rgb", "depth", "mask", "flow", "jpeg", "h264"]
LAST_SECOND = 2**31 - 1
"""Largest time [s]; `builtin_interfaces/msg/Time` stores seconds as int32."""


class Options(Section):
    """Options that define how frames become messages."""

    profile: Profile | None = None
    """Values of each point: viz (x y z rgb), full (also opacity, scales, orientation, velocity),
    small (10 bytes: int16 positions, 8-bit colours), ply (raw 3DGS values for splat viewers) or
    splats (a SplatArray for RVizSplat). The default is `full` for files and `viz` for live topics.
    """
    frame_id: str = Field(default="phy124", min_length=1)
    """Coordinate frame of the object's world."""
    parent_frame: str = "map"
    """Parent frame of the static transform; if empty, no transform is sent."""
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin of the world in the parent frame [m]."""
    rotation: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)
    """Orientation of the world in the parent frame: quaternion x y z w, or roll pitch yaw [rad]."""
    max_points: int | None = Field(
        default=None,
        ge=1,
        description=f"Largest number of Gaussians, evenly selected. Default: {LIVE_POINTS} live, "
        f"all in files. Splats are limited to {LIVE_SPLATS} live.",
    )
    ellipsoids: int = Field(default=0, ge=0, le=10_000)
    """Number of covariance ellipsoids sent as markers."""
    ellipsoid_radius: float = Field(default=2.0, gt=0)
    """Semi-axes of the ellipsoids in standard deviations."""
    draco: int | None = Field(default=None, ge=8, le=24)
    """Also send the points compressed by Draco, with this number of bits per coordinate; 14 bits
    give steps of 1/16,384 of the object's extent. Default: no.
    """
    epoch: float | None = Field(default=None, ge=1, lt=LAST_SECOND)
    """Time of the clip's start, seconds since 1970; by default, the present time."""
    views: tuple[str, ...] = ()
    """Cameras whose pictures are sent: front, right, back, left, orbit, an azimuth [deg], or the
    name of a camera of the scene. Default: none.
    """
    cameras: Path | None = None
    """TOML file with additional cameras, as [[view.cameras]] in a scene."""
    images: tuple[Image, ...] = Field(default=("rgb", "depth"), min_length=1)
    """Data that a camera sends: rgb, depth [m], mask, flow [px], jpeg, h264."""
    size: str = "640x480"
    """Width and height of the pictures, or one number for both [pixels]."""

    @field_validator("frame_id", "parent_frame")
    @classmethod
    def _tf2_name(cls, value: str) -> str:
        if value.startswith("/"):
            raise ValueError("tf2 refuses frame names that begin with a slash. Omit the slash.")
        return value

    @field_validator("rotation")
    @classmethod
    def _unit(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) == 3:
            return quaternion(*value)
        if len(value) != 4:
            raise ValueError("Give x y z w, or roll pitch yaw.")
        length = math.hypot(*value)
        if length < 1e-9:
            raise ValueError(
                "A quaternion of zeros is not a rotation. Use 0 0 0 1 for no rotation."
            )
        x, y, z, w = (component / length for component in value)
        if abs(x) >= abs(w):
            now, before = (
                " ".join(f"{a:.6g}" for a in angles(*q)) for q in ((x, y, z, w), (y, z, w, x))
            )
            raise ValueError(
                "The order is x y z w. Earlier versions had w x y z. These four numbers are valid "
                "in both orders. "
                f"Give roll pitch yaw: {now} if it is x y z w, {before} if it is w x y z."
            )
        return x, y, z, w

    @model_validator(mode="after")
    def _frames_differ(self) -> Options:
        if self.parent_frame == self.frame_id:
            raise ValueError(
                f"The parent frame and the frame are both {self.frame_id!r}; a frame cannot be its "
                "own parent. Rename one frame, or leave the parent empty to send no transform."
            )
        return self

    @model_validator(mode="after")
    def _images_have_cameras(self) -> Options:
        usual = type(self).model_fields["images"].default
        if self.images != usual and not self.views and self.cameras is None:
            raise ValueError(
                "Images need a camera, but no camera is chosen. Set views or cameras, or remove "
                "images."
            )
        return self

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras in topics, without the hyphens and dots that ROS forbids.

        Raises:
            InputError: The file of cameras cannot be read.
        """
        if not self.views and self.cameras is None:
            return ()
        from phy124.scene.files import read_cameras

        named = [] if self.cameras is None else read_cameras(self.cameras)
        angles = {view: azimuth(view) for view in self.views}
        sides = [
            view if angle is None else f"azimuth-{angle % 360:g}" for view, angle in angles.items()
        ]
        sides += [str(camera.get("name", camera.get("kind"))) for camera in named]
        return tuple(map(camera_name, sides))

    def live(self) -> Options:
        """Return the options with the defaults of live sinks: few enough points for 30 Hz."""
        chosen = {
            "max_points": live_points(self.profile, self.max_points),
            "profile": self.profile or LIVE_PROFILE,
        }
        return self.model_copy(update=chosen)

    def for_recording(self) -> Options:
        """Return the options with the defaults of recordings, which contain all points."""
        return self.model_copy(update={"profile": self.profile or "full"})


def azimuth(view: str) -> float | None:
    """Return the azimuth [deg] of a view whose name is a number; None if the name is a word."""
    try:
        return float(view)
    except ValueError:
        return None


def camera_name(side: str) -> str:
    """Return a camera's name in topics and coordinate frames, without hyphens and dots."""
    return re.sub(r"\W", "_", side)


def live_points(profile: Profile | None, asked: int | None) -> int:
    """Return the number of Gaussians per frame of a live profile.

    The result is `asked`, or the default if `asked` is 0 or None.
    """
    if profile == "splats":
        return min(asked or LIVE_SPLATS, LIVE_SPLATS)
    return asked or LIVE_POINTS


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion x y z w of rotations [rad] about the fixed axes x, then y, then z."""
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(angle / 2), math.sin(angle / 2)) for angle in (roll, pitch, yaw)
    )
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def angles(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Return roll, pitch and yaw [rad] of a unit quaternion.

    Args:
        x: Imaginary part along x.
        y: Imaginary part along y.
        z: Imaginary part along z.
        w: Real part.
    """
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw
