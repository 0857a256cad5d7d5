"""Compares phy124's renderer with gsplat in turn: milliseconds per picture, and differences.

`ours_ms` is the time of a picture in float32, as gsplat makes it, and `bytes_ms` the time of a
picture in bytes. Both include the copy to the host. `gpu_ms` is the time per picture if `FRAMES`
pictures in bytes are started together. `film_ms` is the time per picture of a clip with `FRAMES`
pictures, and `staged_ms` the same on the stage studio.
"""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from arguments import device_asked

sys.path.insert(0, str(Path(__file__).parents[1]))
from render import shell, standing

from phy124.camera import Camera
from phy124.gaussians import Frame, Gaussians
from phy124.rendering.frames import render_frames
from phy124.rendering.render import Renderer

wp.config.log_level = wp.LOG_WARNING
SIZES, TURNS, FRAMES = (256, 512, 800), 20, 70


def timed(draw: Callable[[], Any], device: str) -> tuple[Any, float]:
    """A picture, and the median of milliseconds."""
    draw()
    spent = []
    for _ in range(1 if device == "cpu" else TURNS):
        start = time.perf_counter()
        image = draw()
        spent.append(time.perf_counter() - start)
    return image, float(np.median(spent)) * 1e3


def with_gsplat(g: Gaussians, camera: Camera, device: str) -> Callable[[], np.ndarray]:
    """The same picture by gsplat, its own way of loading and its classic filter."""
    import gsplat
    import torch

    def upload(array: Any) -> Any:
        return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32, device=device)

    arrays = [upload(a) for a in (g.means, g.quats, g.scales, g.opacities, g.sh)]
    view, k = upload(camera.view)[None], upload(camera.intrinsics)[None]
    white = upload(np.ones((1, 3)))

    def draw() -> np.ndarray:
        rgb, _, _ = gsplat.rasterization(
            *arrays,
            view,
            k,
            camera.width,
            camera.height,
            sh_degree=g.sh_degree,
            backgrounds=white,
            rasterize_mode="classic",
        )
        return rgb[0].cpu().numpy()

    return draw


def films(g: Gaussians, camera: Camera, renderer: Renderer) -> dict[str, float]:
    """Milliseconds per picture of a clip: started together, as a film, and on a stage."""
    device = str(renderer.device)
    count = FRAMES if renderer.device.is_cuda else 2
    frames = [
        Frame(i, i / 24, replace(g, means=g.means + np.float32(1e-3 * i))) for i in range(count)
    ]
    standing_stage = standing(g, device, count)

    def together() -> None:
        for wait in [renderer.start_picture(frame.gaussians, camera) for frame in frames]:
            wait()

    def film(stage: Any = None) -> None:
        for _ in render_frames(frames, camera, device=device, stage=stage):
            pass

    def staged() -> None:
        standing_stage.frames.clear()
        film(standing_stage.at)

    spent = {}
    for name, draw in (("gpu_ms", together), ("film_ms", film), ("staged_ms", staged)):
        draw()
        start = time.perf_counter()
        draw()
        spent[name] = (time.perf_counter() - start) / count * 1e3
    return spent


def main(count: int, device: str) -> None:
    """A row per size."""
    g, renderer = shell(count), Renderer(device=device)
    there = find_spec("gsplat") is not None and device != "cpu"
    for size in SIZES:
        camera = Camera.orbit(30, 20, 1.6, size)
        ours, ms = timed(lambda camera=camera: renderer(g, camera), device)
        row = {"what": "pictures", "gaussians": count, "size": size, "ours_ms": round(ms, 3)}
        _, ms = timed(lambda camera=camera: renderer.picture(g, camera), device)
        row |= {"bytes_ms": round(ms, 3)}
        row |= {name: round(ms, 3) for name, ms in films(g, camera, renderer).items()}
        if there:
            theirs, ms = timed(with_gsplat(g, camera, device), device)
            row |= {"gsplat_ms": round(ms, 3), "largest": float(np.abs(theirs - ours).max())}
        else:
            row["gsplat"] = "not measured: not installed, or no CUDA device"
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    asked = device_asked(__doc__, 65_536)
    main(asked.count, asked.device)
