"""Encode frames as messages, for all sinks."""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from phy124.gaussians import Frame

from . import cdr
from .camera_messages import encode_picture, list_topics, transform_of
from .cameras import SeenFrame
from .layout import Profile, cloud, draco_cloud, evenly, require_draco, splat_array
from .options import Options
from .topics import DRACO, ELLIPSOIDS, POINTS, SPLATS, TF, TF_STATIC, Message, Topic

SPHERE, DELETE_ALL = 2, 3
"""Type and action of a `visualization_msgs/msg/Marker`."""
CLEARING = 48
"""Number of first messages that remove all earlier markers, such as those of another clip. Several
messages do so, because a subscriber that connects late misses the first ones. All messages would
force RViz to create its spheres again in every frame.
"""
THINNEST = 1e-6
"""Smallest diameter of a marker [m], because RViz rejects zero."""
log = logging.getLogger(__name__)


class FrameEncoder:
    """Encodes frames as messages; unless `quiet` is set, warns once about omitted data."""

    def __init__(self, options: Options, *, quiet: bool = False) -> None:
        if options.draco:
            require_draco()
        self.options = options.for_recording()
        self._profile: Profile = self.options.profile or "full"
        self._quiet, self._announced = quiet, set[str]()
        self._cleared = 0
        self._fixed: dict[str, dict[str, Any]] = {}  # transforms of fixed cameras, by name

    @cached_property
    def start(self) -> float:
        """Time at which the clip starts [s since 1970]; by default, the time of the first call."""
        return time.time() if self.options.epoch is None else self.options.epoch

    @property
    def epoch(self) -> int:
        """Time at which the clip starts [ns since 1970]."""
        return self.stamp(0.0)

    @property
    def topics(self) -> list[Topic]:
        """Topics that will be published; the static transform is first."""
        cameras = list_topics(self.options)
        static = [TF_STATIC] if self.options.parent_frame or cameras else []
        markers = [ELLIPSOIDS] if self.options.ellipsoids else []
        draco = [DRACO] if self.options.draco else []
        return [*static, self.main, *draco, *markers, *([TF, *cameras] if cameras else [])]

    @property
    def main(self) -> Topic:
        """Topic on which the Gaussians of every frame are published."""
        return SPLATS if self._profile == "splats" else POINTS

    def stamp(self, seconds: float) -> int:
        """Return the time stamp [ns since 1970] of a time in the clip [s]."""
        return cdr.stamp(self.start, seconds)

    def limit(self, points: int | None) -> None:
        """Limit the number of points per frame from now on; None removes the limit."""
        self.options = self.options.model_copy(update={"max_points": points})

    def static(self) -> list[Message]:
        """Return the static transforms of the world and of the fixed cameras.

        A camera is included from its first picture on. The transforms are sent before all frames,
        and again when a camera is added.
        """
        world = {
            "header": {"stamp": cdr.time(self.epoch), "frame_id": self.options.parent_frame},
            "child_frame_id": self.options.frame_id,
            "transform": {
                "translation": self.options.translation,
                "rotation": self.options.rotation,
            },
        }
        links = [*([world] if self.options.parent_frame else []), *self._fixed.values()]
        return [cdr.message(TF_STATIC, self.epoch, {"transforms": links})] if links else []

    def encode(self, frame: Frame) -> list[Message]:
        """Return the messages of a frame, with time stamps relative to the start of the clip."""
        stamp = self.stamp(frame.time)
        header = {"stamp": cdr.time(stamp), "frame_id": self.options.frame_id}
        shown = self._thin(frame)
        messages = [self._gaussians(shown, stamp, header)]
        if self.options.draco:
            content = draco_cloud(shown, self.options.draco, header)
            messages.append(cdr.message(DRACO, stamp, content))
        if self.options.ellipsoids:
            messages.append(cdr.message(ELLIPSOIDS, stamp, self._ellipsoids(frame, header)))
        return messages + self._pictures(frame, stamp)

    def _pictures(self, frame: Frame, stamp: int) -> list[Message]:
        """Return the messages of a frame's pictures; messages with transforms come first."""
        pictures = frame.pictures if isinstance(frame, SeenFrame) else ()
        links = {p.name: transform_of(p, self.options, stamp) for p in pictures if not p.fixed}
        messages = [cdr.message(TF, stamp, {"transforms": [*links.values()]})] if links else []
        new = [p for p in pictures if p.fixed and p.name not in self._fixed]
        if new:
            self._fixed |= {p.name: transform_of(p, self.options, self.epoch) for p in new}
            messages += self.static()
        for picture in pictures:
            messages += encode_picture(picture, self.options, stamp)
        return messages

    def _gaussians(self, shown: Frame, stamp: int, header: dict[str, Any]) -> Message:
        if self._profile == "splats":
            data = splat_array(shown.gaussians, stamp, self.options.frame_id)
            return Message(SPLATS, stamp, data)
        return cdr.message(POINTS, stamp, cloud(shown, self._profile, header))

    def _thin(self, frame: Frame) -> Frame:
        if self._profile == "full" and frame.velocities is None:
            self._announce("The frames have no velocities, so vx, vy and vz are NaN.")
        count, limit = len(frame.gaussians), self.options.max_points
        which = evenly(count, limit)
        if which is None:
            return frame
        self._announce(f"Sending {limit:,} of {count:,} Gaussians, evenly selected (max_points).")
        velocities = None if frame.velocities is None else frame.velocities[which]
        return replace(frame, gaussians=frame.gaussians.select(which), velocities=velocities)

    def _ellipsoids(self, frame: Frame, header: dict[str, Any]) -> dict[str, Any]:
        gaussians, limit = frame.gaussians, self.options.ellipsoids
        which = evenly(len(gaussians), limit)
        if which is not None:
            self._announce(f"Sending {limit:,} of {len(gaussians):,} Gaussians as ellipsoids.")
            gaussians = gaussians.select(which)
        quats = gaussians.quats / np.linalg.norm(gaussians.quats, axis=1, keepdims=True)
        poses = np.concatenate([gaussians.means, quats[:, [1, 2, 3, 0]]], axis=1).tolist()
        diameters = 2 * self.options.ellipsoid_radius * gaussians.scales
        sizes = np.maximum(diameters, THINNEST).tolist()
        colours = np.concatenate([gaussians.rgb, gaussians.opacities[:, None]], axis=1).tolist()
        rows = enumerate(zip(poses, sizes, colours, strict=True))
        same = {"header": header, "ns": self.options.frame_id, "type": SPHERE}
        markers = [
            {**same, "id": i, "pose": pose, "scale": size, "color": colour}
            for i, (pose, size, colour) in rows
        ]
        if self._cleared < CLEARING:
            self._cleared += 1
            markers.insert(0, {"header": header, "action": DELETE_ALL})
        return {"markers": markers}

    def _announce(self, what: str) -> None:
        if not self._quiet and what not in self._announced:
            self._announced.add(what)
            log.warning(what)
