"""What the stage costs: `python tests/benchmarks/stage.py [--scenes drop,press,...]`.

Prints one JSON line per scene: median processor time of a picture of the film's five sides, as the
bytes that an encoder gets, without and with the stage, drawn in turn, the shadow map that they
share, and what all that adds, in percent, for five sides and for one. Each scene is simulated from
the example duck at draft accuracy and drawn at 512 x 512; on a busy machine other programs empty
the caches, which costs both. With `--clips FOLDER` clips are kept there and read again.
"""

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path

import warp as wp

from phy124 import pipeline
from phy124.camera import Camera
from phy124.gaussians import Frame
from phy124.io.clip import Clip
from phy124.rendering.framing import cameras, fitted
from phy124.rendering.render import Renderer
from phy124.rendering.stage.build import stage_of
from phy124.scene import Scene
from phy124.scene.scene import preset_names

REVISION = 2
"""Raise when scene or method change: figures of different revisions do not compare."""
DUCK = Path(__file__).parents[2] / "demo/examples/duck.png"
SIDES = ("front", "right", "back", "left", "orbit")
FRAMES = 6


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


def milliseconds(clip: Clip, repeats: int) -> tuple[float, float, float]:
    """Median processor time of a picture, of one on the stage, and of a shadow map."""
    view = Scene.from_data(clip.scene).view.model_copy(
        update={"size": (512, 512), "stage": "studio", "views": SIDES}
    )
    view, renderer = fitted(clip, view), Renderer(device="cpu")
    seen: list[list[Camera]] = [list(cameras(clip, view, side)) for side in SIDES]
    frames: list[Frame] = list(clip.frames())[:: max(1, len(clip) // FRAMES)]
    times: dict[str, list[float]] = {"plain": [], "staged": [], "shadow": []}
    for _ in range(repeats + 1):
        stage = stage_of(clip, view)
        assert stage is not None
        for frame in frames:
            start = time.process_time()
            shown = stage.at(frame)
            times["shadow"].append(time.process_time() - start)
            for side in seen:
                for kind, around in (("plain", None), ("staged", shown)):
                    start = time.process_time()
                    renderer.picture(frame.gaussians, side[frame.index], stage=around)
                    times[kind].append(time.process_time() - start)
    plain, staged, shadow = (
        1e3 * statistics.median(taken[len(taken) // (repeats + 1) :]) for taken in times.values()
    )
    return plain, staged, shadow


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", default=",".join(preset_names()))
    parser.add_argument("--clips", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING  # nothing but JSON on stdout
    for name in options.scenes.split(","):
        plain, staged, shadow = milliseconds(simulated(name, options.clips), options.repeats)
        row = {"revision": REVISION, "scene": name, "plain": plain, "staged": staged}
        row["shadow"] = shadow
        for sides in (5, 1):
            row[f"percent_{sides}"] = 100 * ((staged + shadow / sides) / plain - 1)
        print(
            json.dumps({k: v if isinstance(v, (str, int)) else round(v, 1) for k, v in row.items()})
        )


if __name__ == "__main__":
    main()
