"""Measures the time of a frame: `python tests/benchmarks/render.py [--device cpu] [--repeats 15]`.

Prints one JSON line per count, size and number of threads. With one thread the figure is the median
processor time of a frame. Frames with a stage, its shadow map and a plate are drawn in turn with
frames without them. With two threads the figure is the wall time per frame of a series of frames,
which is valid only on an idle machine. The scene is a bumpy shell of semi-transparent Gaussians, as
image-to-3D models make them. With 65,536 Gaussians, their median size is 0.75 % of the object.
"""

import argparse
import itertools
import json
import statistics
import time
from dataclasses import replace

import numpy as np
import warp as wp

from phy124.camera import Camera
from phy124.gaussians import Frame, Gaussians
from phy124.io.clip import Clip
from phy124.rendering.frames import render_frames
from phy124.rendering.render import Renderer
from phy124.rendering.stage.build import Stage, make_stage
from phy124.rendering.stage.frame import StageFrame
from phy124.scene import View

REVISION = 2
"""Raise when scene or method change: figures of different revisions do not compare."""


def shell(count: int) -> Gaussians:
    """A bumpy sphere, about 1 m across."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    bumps = 0.06 * np.sin(6 * direction[:, :1]) * np.cos(5 * direction[:, 1:2])
    means = direction * (0.42 + bumps + 0.01 * rng.normal(size=(count, 1)))
    scales = 0.0075 * np.sqrt(65536 / count) * np.exp(0.5 * rng.normal(size=(count, 3)))
    opacities = np.clip(rng.beta(1.2, 1, count), 0.006, 0.999)
    rgb = 0.5 + 0.5 * np.sin(8 * means + np.array([0, 2, 4]))
    return Gaussians.from_rgb(means, rng.normal(size=(count, 4)), scales, opacities, rgb)


def standing(gaussians: Gaussians, device: str, frames: int = 1) -> Stage:
    """The stage of a scene with a floor and a press."""
    clip = Clip.from_frames([Frame(i, i / 24, gaussians) for i in range(frames)])
    boundaries = [{"kind": "ground", "height": -0.5}, {"kind": "press"}]
    stage = make_stage(
        replace(clip, scene={"boundaries": boundaries}), View(stage="studio"), device=device
    )
    assert stage is not None
    return stage


def cpu_ms(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, repeats: int
) -> tuple[float, float]:
    """Median processor times of one frame without and with a stage, drawn in turn."""
    clock = time.process_time if renderer.device.is_cpu else time.perf_counter
    stage, frame = standing(gaussians, str(renderer.device)), Frame(0, 0.0, gaussians)
    seconds: tuple[list[float], list[float]] = ([], [])
    for _ in range(repeats + 1):
        for times, staged in zip(seconds, (False, True), strict=True):
            start = clock()
            stage.frames.clear()
            renderer(gaussians, camera, stage=stage.at(frame) if staged else None)
            times.append(clock() - start)
    plain, staged = (1e3 * statistics.median(times[1:]) for times in seconds)
    return plain, staged


def wall_ms(
    device: str, gaussians: Gaussians, camera: Camera, repeats: int, *, staged: bool
) -> float:
    """Wall time per frame of a run, two at a time; on the stage each makes its shadow map."""
    still = itertools.repeat(Frame(0, 0.0, gaussians), 2 * repeats + 8)
    stage = standing(gaussians, device)

    def around(frame: Frame) -> StageFrame:
        stage.frames.clear()
        return stage.at(frame)

    images = render_frames(
        still, camera, device=device, threads=2, stage=around if staged else None
    )
    for _ in range(8):
        next(images)
    start = time.perf_counter()
    for _ in range(2 * repeats):
        next(images)
    return 1e3 * (time.perf_counter() - start) / (2 * repeats)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default=None)
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING  # nothing but JSON on stdout
    renderer = Renderer(device=options.device)
    device = str(renderer.device)
    for count, size in itertools.product((10_000, 65_536), (256, 512, 800)):
        gaussians, camera = shell(count), Camera.orbit(0, 0, 1.5, size)
        row = {"revision": REVISION, "device": device, "warp": wp.__version__}
        row |= {"gaussians": count, "size": size}
        first, staged = cpu_ms(renderer, gaussians, camera, options.repeats)
        clock = "cpu" if renderer.device.is_cpu else "wall"
        print(
            json.dumps(
                row | {"threads": 1, f"{clock}_ms": round(first, 1), "staged": round(staged, 1)}
            ),
            flush=True,
        )
        if renderer.device.is_cpu:
            two, staged = (
                round(wall_ms(device, gaussians, camera, options.repeats, staged=kind), 1)
                for kind in (False, True)
            )
            print(json.dumps(row | {"threads": 2, "wall_ms": two, "staged": staged}), flush=True)


if __name__ == "__main__":
    main()
