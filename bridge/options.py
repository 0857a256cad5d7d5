"""What a user may choose about the messages, each declared once for code, command line and ROS."""

from __future__ import annotations

import math

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from .layout import Profile

LIVE_POINTS = 32_768
"""Gaussians per frame that a subscriber with stock buffers receives at 30 Hz (docs/bridge.md)."""
LAST_SECOND = 2**31 - 1
"""`builtin_interfaces/msg/Time` counts seconds in an int32."""


class Options(BaseModel):
    """How frames become messages."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    profile: Profile = Field(
        default="full",
        description="Numbers per point: viz (x y z rgb), full (and opacity, scales, orientation, "
        "velocity) or ply (raw 3DGS values for splat viewers).",
    )
    frame_id: str = Field(
        default="phy124", min_length=1, description="Coordinate frame of the object's world."
    )
    parent_frame: str = Field(
        default="map",
        description="Frame the static transform hangs the world on; empty: send no transform.",
    )
    translation: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="Origin of the world in the parent frame [m]."
    )
    rotation: tuple[float, float, float, float] = Field(
        default=(1.0, 0.0, 0.0, 0.0),
        description="Orientation of the world in the parent frame, quaternion w x y z.",
    )
    max_points: int | None = Field(
        default=None,
        ge=1,
        description=f"At most so many Gaussians, evenly picked. Live the default is {LIVE_POINTS}, "
        "in files all.",
    )
    ellipsoids: int = Field(
        default=0, ge=0, le=10_000, description="Show so many covariance ellipsoids as markers."
    )
    ellipsoid_radius: float = Field(
        default=2.0, gt=0, description="Semi-axes of the ellipsoids in standard deviations."
    )
    epoch: float | None = Field(
        default=None,
        ge=1,
        lt=LAST_SECOND,
        description="Time of the clip's start, seconds since 1970; default: now.",
    )

    @field_validator("frame_id", "parent_frame")
    @classmethod
    def _tf2_name(cls, value: str) -> str:
        if value.startswith("/"):
            raise ValueError("tf2 refuses frame names that begin with a slash. Leave it out.")
        return value

    @field_validator("rotation")
    @classmethod
    def _unit(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        length = math.hypot(*value)
        if length < 1e-9:
            raise ValueError("A quaternion of zeros is no rotation. Use 1 0 0 0 for none.")
        return tuple(component / length for component in value)

    @model_validator(mode="after")
    def _frames_differ(self) -> Options:
        if self.parent_frame == self.frame_id:
            raise ValueError(
                f"The parent frame and the frame are both {self.frame_id!r}; a frame cannot hang "
                "on itself. Rename one, or leave the parent empty to send no transform."
            )
        return self

    def live(self) -> Options:
        """The same with the live limit where no other was chosen."""
        return self if self.max_points else self.model_copy(update={"max_points": LIVE_POINTS})
