"""Renders what cameras see in a clip or a running simulation.

The pictures are the same as those that `phy124 render` makes. In a running simulation, however,
later frames are unknown, so the cameras are at `view.distance` from the object at rest, and the
background is plain.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, replace
from functools import cached_property
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.camera import VIEWS, Camera
from phy124.errors import InputError, suggest
from phy124.gaussians import Frame
from phy124.io.clip import Clip

from .options import Options, azimuth, camera_name
from .video import H264Encoder

if TYPE_CHECKING:
    from phy124.rendering.render import Renderer
    from phy124.scene import Scene, View

QUALITY = 90
"""Quality of JPEG pictures, from 0 to 100."""


class Picture(NamedTuple):
    """The pictures of one camera in a frame."""

    name: str
    """Name of the camera in the names of topics and coordinate frames."""
    camera: Camera
    fixed: bool
    """Whether the camera has the same position in all frames."""
    images: Mapping[str, Any]
    """Pictures by kind: rgb uint8 [H,W,3], depth float32 [H,W] m (NaN where nothing is seen), mask
    uint8 [H,W], flow float32 [H,W,2] px since the previous frame, jpeg and h264 bytes."""


@dataclass(frozen=True, eq=False)
class SeenFrame(Frame):
    """A frame with the pictures of all cameras."""

    pictures: tuple[Picture, ...] = ()


class Cameras:
    """Adds the pictures of all chosen cameras to frames."""

    def __init__(
        self, options: Options, scene: Mapping[str, Any], clip: Clip | None = None
    ) -> None:
        """Choose the cameras whose pictures are added to the frames.

        `scene` is the complete scene as plain data; `clip` is None for a running simulation.

        Raises:
            InputError: There is no such camera, or the video encoder does not work.
        """
        self._options, self._clip, self._places = options, clip, list[_Place]()
        self._stack = ExitStack()
        if not options.camera_names:
            return
        import warp

        # Hides the messages that Warp prints during compilation.
        warp.config.log_level = warp.LOG_ERROR
        from phy124.io.video import refuse_missing_encoder
        from phy124.scene import Scene

        if "h264" in options.images:
            refuse_missing_encoder()
        self._scene = Scene.of_clip(dict(scene))
        self._view = choose_view(options, self._scene)
        if clip is not None:
            self._place(clip, self._view)

    def __enter__(self) -> Cameras:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def look(self, frame: Frame) -> Frame:
        """Return the frame together with the pictures of all cameras.

        Raises:
            InputError: The view cannot be rendered.
        """
        if not self._options.camera_names:
            return frame
        if not self._places:
            view = self._view.model_copy(update={"stage": "plain", "fit": False, "follow": False})
            self._place(_standing_clip(frame, self._scene), view)
        tasks = [
            (place, [self._pool.submit(draw, place, frame) for draw in self._draws])
            for place in self._places
        ]
        pictures = []
        for place, drawn in tasks:
            images = {name: image for task in drawn for name, image in task.result().items()}
            camera = place.at(frame.index)
            pictures.append(Picture(place.name, camera, place.fixed, images))
            place.before = frame, camera
        values = {field.name: getattr(frame, field.name) for field in fields(Frame)}
        return SeenFrame(**values, pictures=tuple(pictures))

    def _place(self, clip: Clip, view: View) -> None:
        from phy124.rendering.framing import cameras
        from phy124.rendering.render import Renderer
        from phy124.rendering.shine import make_shine
        from phy124.rendering.stage.build import make_stage
        from phy124.runtime.cores import cores
        from phy124.runtime.device import pick_device

        device = pick_device("auto")
        self._stage = make_stage(clip, view, device=device)
        self._shine = make_shine(clip, view)
        self._background = view.background
        wanted = set(self._options.images)
        self._draws = [self._draw_colours] if wanted & {"rgb", "jpeg", "h264"} else []
        self._draws += [self._draw_values] if wanted & {"depth", "mask", "flow"} else []
        for side in view.sides:
            chosen = view.camera(side)
            circles = side == "orbit" or (chosen is not None and chosen.kind == "turntable")
            place = _Place(camera_name(side), cameras(clip, view, side), circles)
            if "h264" in wanted:
                video = H264Encoder(*view.size, clip.fps)
                place.video = self._stack.enter_context(video)
            self._places.append(place)
        count = min(cores(), len(self._draws) * len(self._places))
        # This renderer loads the kernels, because Warp cannot load kernels in several threads at
        # once.
        first = Renderer(device=device, filter=view.filter)
        count = 1 if first.device.is_cuda else count
        self._renderers: SimpleQueue[Renderer] = SimpleQueue()
        for renderer in (
            first,
            *(Renderer(device=device, filter=view.filter) for _ in range(count - 1)),
        ):
            self._renderers.put(renderer)
        pool = ThreadPoolExecutor(count, thread_name_prefix="camera")
        self._pool = self._stack.enter_context(pool)

    def _draw_colours(self, place: _Place, frame: Frame) -> dict[str, Any]:
        camera = place.at(frame.index)
        # The stage of a running simulation is the same in all frames.
        stage = self._stage and self._stage.at(frame if self._clip else replace(frame, index=0))
        shown = self._shine.illuminate(frame, camera) if self._shine else frame
        with self._renderer() as renderer:
            rgb = renderer.picture(shown.gaussians, camera, self._background, stage=stage)
        images: dict[str, Any] = {"rgb": rgb}
        if "jpeg" in self._options.images:
            images["jpeg"] = compress(rgb)
        if place.video is not None:
            images["h264"] = place.video.encode(rgb)
        return images

    def _draw_values(self, place: _Place, frame: Frame) -> dict[str, Any]:
        from phy124.rendering.outputs import flow, means_seen

        camera, means = place.at(frame.index), frame.gaussians.means
        values: dict[str, NDArray[np.float64]] = {}
        if "depth" in self._options.images:
            values["depth"] = camera.project(means)[1][:, None]
        before = place.before
        if "flow" in self._options.images and before and before[0].index < frame.index:
            values["flow"] = flow(before[0].gaussians.means, before[1], means, camera)
        columns = [np.nan_to_num(value, posinf=0, neginf=0) for value in values.values()]
        with self._renderer() as renderer:
            seen, alpha = means_seen(renderer, frame.gaussians, camera, columns)
        images = dict[str, Any](zip(values, seen, strict=True))
        if "depth" in images:
            images["depth"] = np.where(alpha > 0, images["depth"][..., 0], np.float32(np.nan))
        return images | {"mask": np.rint(alpha * 255).astype(np.uint8)}

    @contextmanager
    def _renderer(self) -> Iterator[Renderer]:
        renderer = self._renderers.get()
        try:
            yield renderer
        finally:
            self._renderers.put(renderer)


@dataclass
class _Place:
    name: str
    path: list[Camera]
    circles: bool
    """Whether the camera repeats its path instead of stopping at the end."""
    video: H264Encoder | None = None
    before: tuple[Frame, Camera] | None = None

    @cached_property
    def fixed(self) -> bool:
        return all(camera == self.path[0] for camera in self.path)

    def at(self, index: int) -> Camera:
        last = len(self.path) - 1
        return self.path[index % len(self.path) if self.circles else min(index, last)]


def choose_view(options: Options, scene: Scene) -> View:
    """Return the scene's view with only the chosen cameras.

    Raises:
        InputError: There is no such camera, or the picture size cannot be used.
    """
    from phy124.scene.files import read_cameras

    stored = {camera.name: camera.model_dump() for camera in scene.view.cameras}
    angles = [angle for view in options.views if (angle := azimuth(view)) is not None]
    words = [view for view in options.views if azimuth(view) is None]
    known = [*VIEWS, "orbit", *stored]
    for word in words:
        if word not in known:
            remedy = suggest(word, known)
            raise InputError("views", word, "the scene has no such camera.", remedy)
    listed = [stored[word] for word in words if word in stored]
    changes = {
        "view.views": [word for word in words if word not in stored],
        "view.azimuths": angles,
        "view.cameras": listed + (read_cameras(options.cameras) if options.cameras else []),
        "view.size": options.size,
    }
    return scene.replaced(changes).view


def compress(rgb: NDArray[np.uint8]) -> bytes:
    """Return a picture [H,W,3] as JPEG."""
    import cv2

    done, data = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    assert done
    return data.tobytes()


def _standing_clip(frame: Frame, scene: Scene) -> Clip:
    clip = Clip.from_frames([Frame(0, 0.0, frame.gaussians)])
    count = scene.time.frames
    still = {
        name: np.broadcast_to(array, (count, *array.shape[1:]))
        for name in ("means", "quats", "scales")
        if (array := getattr(clip, name)) is not None
    }
    times = np.arange(count) / scene.time.fps
    return replace(clip, **still, times=times, scene=scene.data())
