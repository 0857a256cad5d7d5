"""Compares `relief` with vessels photographed from above: `python tests/benchmarks/vessels.py`.

Each object is drawn from an elevation of 25 degrees (`--elevation`) in soft light. What `relief`
makes of this picture is compared with the upright object from the views of `support.truths`, as in
relief.py. `--json FILE` writes the figures, `--against FILE` shows the change since then.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1]))
from relief import GAUSSIANS, drawn

import support.truths as truths
from phy124.camera import Camera
from phy124.gaussians import Gaussians
from phy124.generators.relief import relief
from phy124.rendering.render import Renderer
from support.truths import DISTANCE, FINE, FRONT, SMALL, VIEWS, WIDE
from support.truths.distances import box, torus, turned, without
from support.truths.objects import BLUE, DARK, OBJECTS, WHITE, YELLOW, mottled, part

ELEVATION = 25
AMBIENT, DIFFUSE = 0.6, 0.35
"""Brightness in the shade, and what the lit side has more: softer light than in relief.py."""


def hollow(outer: list, inner: list, colour: tuple) -> object:
    """A vessel between two profiles of (radius, height)."""
    return part(without(turned(outer), turned(inner)), mottled(colour, 0.1))


CUP = hollow([(0.22, 0), (0.36, 0.45)], [(0.18, 0.05), (0.32, 0.6)], WHITE)
BOWL = hollow([(0.2, 0), (0.35, 0.12), (0.5, 0.32)], [(0.14, 0.05), (0.47, 0.4)], BLUE)
POT = hollow([(0.4, 0), (0.42, 0.4)], [(0.37, 0.05), (0.39, 0.6)], (0.6, 0.6, 0.62))
BAND = without(turned([(0.4, -0.1), (0.4, 0.1)]), turned([(0.36, -1), (0.36, 1)]))
VESSELS = {
    "bowl": [BOWL],
    "cup": [CUP, part(torus(0.14, 0.035, 0, (0, 0.42, 0.25)), WHITE)],
    "pot": [POT, *(part(box((0.1, 0.2, 0.06), (0, y, 0.33)), DARK) for y in (-0.5, 0.5))],
    "tin": [part(turned([(0.45, 0), (0.45, 0.3)]), mottled(BLUE, 0.1))],
    "mug": OBJECTS["mug"],
    "drum": OBJECTS["drum"],
    "ring": [part(torus(0.35, 0.05, 2), mottled(YELLOW, 0.1))],
    "bracelet": [part(BAND, YELLOW)],
    "car": OBJECTS["car"],
    "dog": OBJECTS["dog"],
}


def measured(name: str, renderer: Renderer, elevation: float = ELEVATION) -> dict[str, float]:
    """Mean overlap (IoU) of the silhouettes, overlap from the side, and relative depth."""
    solid = truths._placed(VESSELS[name])
    camera = Camera.orbit(0, elevation, DISTANCE, FRONT * FINE, fov_y=WIDE)
    picture, _ = truths._picture(solid, camera)
    made = relief(Image.fromarray(truths._rounded(picture)), count=GAUSSIANS)
    low, high = made.means.min(axis=0), made.means.max(axis=0)
    # The picture shows neither how far away nor how high the object is.
    middle = made.means - np.array([1, 0, 1], np.float32) * (low + high) / 2
    placed = Gaussians(middle, made.quats, made.scales, made.opacities, made.sh)
    overlaps = []
    for view in VIEWS:
        rays = truths._traced(solid, Camera.orbit(*view, DISTANCE, SMALL, fov_y=WIDE))
        right = np.isfinite(rays[:, 0]).reshape(SMALL, SMALL)
        inside = drawn(renderer, placed, view)[..., 3] > 0.5
        overlaps.append((inside & right).sum() / (inside | right).sum())
    width, depth = high[1] - low[1], high[0] - low[0]
    return {
        "iou": float(np.mean(overlaps)),
        "side": float(overlaps[1]),
        "depth": float(depth / width),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--elevation", type=float, default=ELEVATION)
    parser.add_argument("--only", nargs="*", default=list(VESSELS))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--against", type=Path)
    chosen = parser.parse_args()
    truths.AMBIENT, truths.DIFFUSE = AMBIENT, DIFFUSE
    before = json.loads(chosen.against.read_text()) if chosen.against else {}
    renderer, figures = Renderer(device="cpu"), {}
    for name in chosen.only:
        row = figures[name] = measured(name, renderer, chosen.elevation)
        columns = [[old[key] for old in (before.get(name), row) if old] for key in row]
        print(f"| {name} |", *(" | ".join(f"{v:.3f}" for v in pair) + " |" for pair in columns))
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
