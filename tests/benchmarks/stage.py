"""Measures the time of the stage: `python tests/benchmarks/stage.py [--scenes drop,press,...]`.

Prints one JSON line per scene: the CPU time [ms] per picture of a film without and with the stage,
and the increase in per cent for a film of five sides and for a film of one side. The pictures are
in bytes, as an encoder gets them. Films without and with the stage are drawn several times in turn,
and shadow maps are computed again each time. For each picture, the smallest time counts. Each scene
is simulated with the example duck at draft accuracy and drawn at 512 x 512. With `--clips FOLDER`,
clips are stored in this folder and read again.
"""

import argparse
import itertools
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124 import pipeline
from phy124.io.clip import Clip
from phy124.rendering.framing import cameras
from phy124.rendering.render import Renderer
from phy124.rendering.stage.build import Stage, make_stage
from phy124.scene import Scene
from phy124.scene.scene import preset_names

REVISION = 3
"""Raise when scene or method change: figures of different revisions do not compare."""
DUCK = Path(__file__).parents[2] / "demo/examples/duck.png"
SIDES = ("front", "right", "back", "left", "orbit")


def simulated(name: str, kept: Path | None) -> Clip:
    """The clip of a preset, from a folder if it is there."""
    if kept is not None and (kept / f"{name}.safetensors").exists():
        return Clip.load(kept / f"{name}.safetensors")
    changes = {"accuracy": "draft", "view.views": ["front"], "view.azimuths": [], "view.size": 64}
    with tempfile.TemporaryDirectory() as folder:
        pipeline.generate(DUCK, Scene.named(name).replaced(changes), Path(folder) / "made")
        clip = Clip.load(Path(folder) / "made" / "clip.safetensors")
    if kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
        clip.save(kept / f"{name}.safetensors")
    return clip


def milliseconds(clip: Clip, sides: tuple[str, ...], repeats: int) -> tuple[float, float]:
    """Processor time of a picture of a film without and with the stage."""
    view = Scene.from_data(clip.scene).view.model_copy(
        update={"size": (512, 512), "stage": "studio", "views": sides}
    )
    renderer = Renderer(device="cpu")
    seen = [list(cameras(clip, view, side)) for side in sides]
    frames = list(clip.frames())
    plain, staged = np.full((2, len(sides), len(frames)), np.inf)
    begin = np.inf

    def film(least: NDArray, stage: Stage | None) -> None:
        for side, frame in itertools.product(range(len(sides)), frames):
            start = time.process_time()
            around = stage and stage.at(frame)
            renderer.picture(frame.gaussians, seen[side][frame.index], stage=around)
            taken = time.process_time() - start
            least[side, frame.index] = min(least[side, frame.index], taken)

    for _ in range(repeats):
        film(plain, None)
        start = time.process_time()
        stage = make_stage(clip, view)
        begin = min(begin, time.process_time() - start)
        film(staged, stage)
    return 1e3 * plain.mean(), 1e3 * (staged.mean() + begin / staged.size)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", default=",".join(preset_names()))
    parser.add_argument("--clips", type=Path)
    parser.add_argument("--repeats", type=int, default=4)
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING  # nothing but JSON on stdout
    for name in options.scenes.split(","):
        clip = simulated(name, options.clips)
        row: dict[str, Any] = {"revision": REVISION, "scene": name}
        for sides in (SIDES, SIDES[:1]):
            plain, staged = milliseconds(clip, sides, options.repeats)
            many = len(sides)
            row |= {f"plain_{many}": round(plain, 2), f"staged_{many}": round(staged, 2)}
            row[f"percent_{many}"] = round(100 * (staged / plain - 1), 1)
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
