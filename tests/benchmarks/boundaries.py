"""Measures the outlines of cut-outs: `python tests/benchmarks/boundaries.py --json FILE`.

The real objects of $PHY124_OBJECTS or ../shared/objects are pasted on photographs of scikit-image
and cut out by a method. Some of them are thin: a bare tree, leaves, horns, a sword. The program
prints the overlap with the true mask (IoU) and the boundary F-score. The F-score is the harmonic
mean of two fractions: the part of the cut-out's outline within `NEAR` of the true outline, and the
part of the true outline within `NEAR` of the cut-out's outline. `--against FILE` shows the change
relative to an earlier file.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1]))
from backs import FOLDER, FRONTS, REAL, renderer, straight
from cutouts import SIDE, Known, grounds

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.generators.ply_file import PlyFile, Reading
from phy124.imaging.cutout import foreground

GROUNDS = ("gravel", "grass", "brick", "wood", "a garage with a motorcycle", "the moon")
NEAR = 0.002
"""Distance at which outlines agree, in diagonals of the picture."""
VIEWS = ((25, 12), (-50, 20))


def pasted() -> Iterator[tuple[str, Known]]:
    """Yield every object on three grounds, from a direction and at a position drawn at random."""
    rng = np.random.default_rng(1)
    shown = dict(grounds())
    for index, name in enumerate((*REAL, "plant")):
        reading = Reading(up="-y", front=FRONTS.get(name, "-z"))
        gaussians = PlyFile(str(FOLDER / f"{name}.splat"), reading)()
        for turn in range(3):
            side = int(rng.uniform(0.5, 0.85) * SIDE)
            camera = Camera.orbit(*VIEWS[turn % 2], 2.4, 2 * side, fov_y=34)
            fine = renderer()(gaussians, camera, alpha=True)
            rgba = straight(fine.reshape(side, 2, side, 2, 4).mean(axis=(1, 3)))
            place = tuple(int(v) for v in rng.uniform(0, 1, 2) * (SIDE - side))
            layer = Image.new("RGBA", (SIDE, SIDE))
            layer.paste(Image.fromarray(np.round(255 * rgba).astype(np.uint8)), place)
            ground = GROUNDS[(index + 2 * turn) % len(GROUNDS)]
            whole = Image.alpha_composite(Image.fromarray(shown[ground]).convert("RGBA"), layer)
            yield name, Known(ground, np.asarray(whole.convert("RGB")), np.asarray(layer)[..., 3])


def outline(solid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the outermost pixels of a mask."""
    return solid & ~(cv2.erode(solid.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)


def scores(alpha: NDArray[np.uint8], known: Known) -> dict[str, float]:
    """Return overlap and boundary F-score of a cut-out."""
    result, true = alpha > 127, known.alpha > 127
    lines = outline(result), outline(true)
    reach = NEAR * float(np.hypot(*true.shape))
    away = [cv2.distanceTransform(1 - line.astype(np.uint8), cv2.DIST_L2, 5) for line in lines]
    precision = float((away[1][lines[0]] <= reach).mean()) if lines[0].any() else 0.0
    recall = float((away[0][lines[1]] <= reach).mean())
    boundary = 2 * precision * recall / max(precision + recall, 1e-9)
    return {"iou": float((result & true).sum() / (result | true).sum()), "boundary": boundary}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--method", default="u2netp")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--against", type=Path)
    chosen = parser.parse_args()
    before = json.loads(chosen.against.read_text()) if chosen.against else {}
    figures: dict[str, dict[str, float]] = {}
    for name, known in pasted():
        try:
            cutout = foreground(Image.fromarray(known.rgb), chosen.method)
            figures[f"{name} on {known.ground}"] = scores(np.asarray(cutout.picture)[..., 3], known)
        except InputError:
            figures[f"{name} on {known.ground}"] = {"iou": 0.0, "boundary": 0.0}
    for field in ("iou", "boundary"):
        values = np.array([row[field] for row in figures.values()])
        text = f"{field}: mean {values.mean():.3f}, median {np.median(values):.3f}"
        if before:
            change = values - [before[key][field] for key in figures]
            text += f", change {change.mean():+.3f}, {(change > 0.02).sum()} better and"
            text += f" {(change < -0.02).sum()} worse by over 0.02, worst {change.min():+.3f}"
        print(text)
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
