"""Our renderer and gsplat side by side: milliseconds per picture, and how far they differ."""

import json
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from arguments import device_asked

sys.path.insert(0, str(Path(__file__).parents[1]))
from render import shell

from phy124.camera import Camera
from phy124.gaussians import Gaussians
from phy124.rendering.render import Renderer

wp.config.log_level = wp.LOG_WARNING
SIZES, TURNS = (256, 512, 800), 20


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

    def given(array: Any) -> Any:
        return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32, device=device)

    arrays = [given(a) for a in (g.means, g.quats, g.scales, g.opacities, g.sh)]
    view, k = given(camera.view)[None], given(camera.intrinsics)[None]
    white = given(np.ones((1, 3)))

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


def main(count: int, device: str) -> None:
    """A row per size."""
    g, renderer = shell(count), Renderer(device=device)
    there = find_spec("gsplat") is not None and device != "cpu"
    for size in SIZES:
        camera = Camera.orbit(30, 20, 1.6, size)
        ours, ms = timed(lambda camera=camera: renderer(g, camera), device)
        row = {"what": "pictures", "gaussians": count, "size": size, "ours_ms": round(ms, 3)}
        if there:
            theirs, ms = timed(with_gsplat(g, camera, device), device)
            row |= {"gsplat_ms": round(ms, 3), "largest": float(np.abs(theirs - ours).max())}
        else:
            row["gsplat"] = "not measured: not installed, or no CUDA device"
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    asked = device_asked(__doc__, 65_536)
    main(asked.count, asked.device)
