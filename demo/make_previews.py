"""Render the previews of preset cards and materials, and the finished results on the page.

Run `python -m demo.make_previews` again after changes of presets or their physics. Each preview
takes a few seconds. A finished result consists of a video and, for some presets, a 3D player.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.camera import Camera
from phy124.gaussians import Frame
from phy124.generators import make
from phy124.imaging.cutout import cut_out
from phy124.io.clip import Clip
from phy124.io.html import pack
from phy124.progress import silent
from phy124.rendering.frames import render_frames
from phy124.rendering.framing import still_camera
from phy124.rendering.shine import make_shine
from phy124.rendering.stage.build import make_stage, pack_stage
from phy124.scene import Scene, View, preset_names
from phy124.simulation import Simulation, prepare

from .catalogue import PREVIEWS, READY, SUBSTANCES
from .work.shows import thin_frame

Pictures = list[NDArray[np.uint8]]

FOLDER = Path(__file__).parent
OBJECTS = {
    "sway": "potted_plant", "drop": "pear", "bounce": "chick", "spin": "cupcake", "sand": "cupcake",
    "snow": "teddy", "water": "pear", "jelly": "cupcake", "wind": "sunflower", "foam": "mushroom",
    "land_on_cushion": "pear", "bury": "chick", "stack": "cupcake", "honey": "pear", "oil": "pear",
}  # fmt: skip
"""Example picture of each preset. Presets that are not listed use the duck."""
FALL = 36
"""Number of frames of a material's preview, in which the object lands but does not topple."""
FRAMES = {"water": 11}
"""Number of frames for materials that would otherwise spread beyond the edge of the card."""
LONGEST = 24
"""Largest number of pictures in a preview. Longer clips are subsampled."""
SIZE, CHIP = 200, 128
"""Sides of the square previews of presets and of materials [pixels]."""
CLOSE = 0.72
"""Field of view of a material's preview, divided by the field of view of a preset's preview."""
FILM = (800, 600)
"""Width and height of the video of a finished result [pixels]."""
LARGEST = 500_000
"""Largest size of a preview's file [bytes]."""
PLAYERS, SPLATS = ("press", "bounce", "jelly"), 9_000
"""Presets whose finished results have a 3D player, with the number of Gaussians in the player."""


def main() -> None:
    """Render all previews, or only those that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    materials = [f"material_{name}" for name in SUBSTANCES]
    ready = [f"ready_{name}" for name in READY]
    parser.add_argument("names", nargs="*", default=[*preset_names(), *materials, *ready])
    for name in parser.parse_args().names:
        path = PREVIEWS / f"{name}.webp"
        if name in ready:
            make_ready(name.removeprefix("ready_"))
        elif name in materials:
            make_preview(substance_scene(name.removeprefix("material_")), "duck", path, CHIP)
        else:
            scene = Scene.named(name).replaced({"accuracy": "draft"})
            make_preview(scene, OBJECTS.get(name, "duck"), path, SIZE)


def substance_scene(name: str) -> Scene:
    """Return the scene of a material's preview, in which the object falls to the ground."""
    drop = Scene.named("drop").replaced({"accuracy": "draft", "material": SUBSTANCES[name]})
    return drop.replaced({"time.frames": FRAMES.get(name, FALL)})


def make_preview(scene: Scene, example: str, path: Path, size: int) -> None:
    """Simulate a scene, and render it from the front and slightly above.

    Args:
        scene: The scene.
        example: Name of the example picture.
        path: The file to write.
        size: Width and height of the preview [pixels].
    """
    clip = _simulate(scene, example)
    path.parent.mkdir(exist_ok=True)
    view = scene.view.model_copy(update={"size": (size, size), "stage": "studio"})
    step = -(-len(clip) // LONGEST)
    camera = still_camera(clip, view, "front")
    if size == CHIP:
        camera = replace(camera, fov_y=CLOSE * camera.fov_y)
    _save(_telling(_film(clip, view, camera, step)), scene, step, path, quality=60)


def make_ready(name: str) -> None:
    """Make a preset's finished result: video, processor time, and for some presets a 3D player."""
    scene = Scene.named(name).replaced({"accuracy": "draft"})
    start = time.process_time()
    clip = _simulate(scene, READY[name][1])
    seconds = time.process_time() - start
    view = scene.view.model_copy(update={"size": FILM, "stage": "studio"})
    camera, step = still_camera(clip, view, "front"), -(-len(clip) // LONGEST)
    films = _film(clip, view, camera, step)
    _save(films, scene, step, PREVIEWS / f"ready_{name}.webp", quality=70)
    times = PREVIEWS / "ready.json"
    known = json.loads(times.read_text("utf-8")) if times.exists() else {}
    times.write_text(json.dumps({**known, name: round(seconds, 1)}, indent=1) + "\n", "utf-8")
    if name in PLAYERS:
        some = _thin(clip, step)
        staged = pack_stage(make_stage(some, view), some)
        data = pack(some, camera, background=view.background, stage=staged)
        (PREVIEWS / f"ready_{name}.pack").write_bytes(data)


def _simulate(scene: Scene, example: str) -> Clip:
    cutout = cut_out(FOLDER / "examples" / f"{example}.png").picture
    return Simulation(prepare(make("relief")(cutout, seed=0, progress=silent), scene)).run()


def _thin(clip: Clip, step: int) -> Clip:
    count = clip.means.shape[1]
    chosen = np.sort(np.random.default_rng(0).permutation(count)[:SPLATS])
    frames = [thin_frame(frame, chosen) for frame in list(clip.frames())[::step]]
    return replace(Clip.from_frames(frames), scene=clip.scene)


def _save(images: list[Image.Image], scene: Scene, step: int, path: Path, quality: int) -> None:
    """Save an animation that plays at 0.6 times the scene's speed. The quality is reduced until the
    file is at most `LARGEST` bytes.
    """
    duration = round(1000 * step / (0.6 * scene.time.fps))
    for lower in range(quality, 0, -10):
        images[0].save(
            path,
            save_all=True,
            append_images=images[1:],
            duration=duration,
            loop=0,
            quality=lower,
            alpha_quality=80 if quality > 60 else 60,
            method=6,
        )
        if path.stat().st_size <= LARGEST:
            return


def _film(clip: Clip, view: View, camera: Camera, step: int) -> list[Image.Image]:
    """Render frames with a transparent background, because the page may be light or dark."""
    frames, shine = list(clip.frames())[::step], make_shine(clip, view)
    if shine is not None:
        frames = [shine.illuminate(frame, camera) for frame in frames]
    black, white = (_draw_on(grey, clip, frames, camera, view) for grey in (0.0, 1.0))
    clear = [_clear(dark, light) for dark, light in zip(black, white, strict=True)]
    return [*clear, *[clear[-1]] * 4]


def _draw_on(grey: float, clip: Clip, frames: list[Frame], camera: Camera, view: View) -> Pictures:
    colour = (grey, grey, grey)
    plain = {"background": colour, "gradient": None, "picture": None}
    stage = make_stage(clip, view.model_copy(update=plain))
    at = None if stage is None else replace(stage, pool=0.0).at
    return list(render_frames(frames, camera, background=colour, stage=at))


def _clear(on_black: NDArray, on_white: NDArray) -> Image.Image:
    """Compute a transparent picture from renderings on a black and on a white background."""
    dark, light = on_black.astype(np.float32), on_white.astype(np.float32)
    alpha = 255 - (light - dark).mean(axis=2, keepdims=True).clip(0, 255)
    colour = np.where(alpha > 0, dark * 255 / np.maximum(alpha, 1), 0).clip(0, 255)
    return Image.fromarray(np.concatenate([colour, alpha], axis=2).astype(np.uint8))


def _telling(images: list[Image.Image]) -> list[Image.Image]:
    """Reorder the pictures of a loop: begin with the picture that differs most from the first."""
    pixels = np.array([np.asarray(image, np.int16) for image in images])
    changed = np.abs(pixels - pixels[0]).sum(axis=(1, 2, 3))
    start = int(changed.argmax())
    return images[start:] + images[:start]


if __name__ == "__main__":
    main()
