"""Show a motion while it is computed: small pictures, and frames for the 3D viewer."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from PIL import Image

from phy124 import pipeline
from phy124.camera import Camera
from phy124.errors import Cancelled
from phy124.gaussians import Frame, Gaussians
from phy124.io.clip import Clip
from phy124.io.html import pack
from phy124.rendering.render import Renderer
from phy124.rendering.stage.build import Stage, make_stage, pack_stage
from phy124.rendering.stage.rest import AtRest
from phy124.scene import Scene

from ..progress import Glimpse, Live, Tell
from .order import Order

GLIMPSE = 224
"""Width and height of the pictures shown during the simulation [pixels]."""
SHOWN = 12_000
"""Number of Gaussians in the viewer during the simulation."""
ROOMY = 2.4
"""Distance of the camera during the simulation, as a multiple of the object's size."""


def glimpses(order: Order, tell: Tell) -> Callable[[Frame], None]:
    """Return a function that shows frames as small pictures during the run."""
    renderer, camera, rest = Renderer(device=order.device), None, None

    def show(frame: Frame) -> None:
        nonlocal camera, rest
        camera = camera or _camera(frame, order.scene)
        rest = rest or AtRest.of(Clip.from_frames([frame]))
        stage = _stage(frame, order.scene, rest)
        around = stage and stage.at(replace(frame, index=0))
        picture = renderer.picture(
            frame.gaussians, camera, order.scene.view.background, stage=around
        )
        with io.BytesIO() as file:
            Image.fromarray(picture).save(file, "JPEG", quality=80)
            tell(Glimpse(file.getvalue()))

    return show


def lives(order: Order, tell: Tell) -> Callable[[Frame], None]:
    """Return a function that sends frames with fewer, larger Gaussians to the 3D viewer."""
    folder = order.folder / "live" / order.stop.name
    shutil.rmtree(folder.parent, ignore_errors=True)
    folder.mkdir(parents=True)
    chosen, camera, rest = None, None, None

    def show(frame: Frame) -> None:
        nonlocal chosen, camera, rest
        count = len(frame.gaussians)
        camera = camera or _camera(frame, order.scene)
        if chosen is None:
            rng = np.random.default_rng(0)
            chosen = np.sort(rng.permutation(count)[:SHOWN])
        some = thin_frame(frame, chosen)
        path = folder / f"{frame.index:04d}.pack"
        background = order.scene.view.background
        rest = rest or AtRest.of(Clip.from_frames([frame]))
        clip = Clip.from_frames([some])
        around = pack_stage(_stage(some, order.scene, rest), clip)
        data = pack(clip, camera, background=background, stage=around)
        try:
            path.write_bytes(data)
        except FileNotFoundError:
            # The visitor's folder has been removed in the meantime.
            raise Cancelled from None
        tell(Live(str(path)))

    return show


def thin_frame(frame: Frame, chosen: np.ndarray) -> Frame:
    """Select some of a frame's Gaussians, and enlarge them so that they cover the same area."""
    g = frame.gaussians
    larger = g.scales[chosen] * (len(g) / len(chosen)) ** 0.5
    some = Gaussians(g.means[chosen], g.quats[chosen], larger, g.opacities[chosen], g.sh[chosen])
    return Frame(frame.index, frame.time, some)


def _stage(frame: Frame, scene: Scene, rest: AtRest) -> Stage | None:
    clip = replace(Clip.from_frames([frame]), scene={"boundaries": scene.data()["boundaries"]})
    return make_stage(clip, scene.view, rest=rest)


def _camera(frame: Frame, scene: Scene) -> Camera:
    """Return a camera with a margin around the object, because its motion is not known yet."""
    rest = Clip.from_frames([frame])
    clip = Clip(**{**vars(rest), "scene": scene.data()})
    usual = {"size": (GLIMPSE, GLIMPSE), "fit": False}
    if scene.view.fits:
        usual["distance"] = ROOMY
    view = scene.view.model_copy(update=usual)
    return pipeline.cameras(clip, view, "front")[0]
