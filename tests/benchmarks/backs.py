"""Measures the unseen sides of `relief`'s objects: `python tests/benchmarks/backs.py --json FILE`.

The objects are the 38 solids (`support.truths`) and the real objects in $PHY124_OBJECTS or
../shared/objects. Each is drawn from its front, and `relief` makes an object from this picture. The
program compares the pictures from behind (PSNR inside the true silhouette [dB]), the silhouettes
from eight other sides (IoU), and the surfaces. For the surfaces, it computes the chamfer distance
(mean of both directions [% of the object]) and the mean angle between the normals of nearest points
[degrees]. `--against FILE` shows the change relative to an earlier file, and `--look NAME` chooses
the look of the back. `--pictures FILE` writes pictures of front, back and side (truth above).
"""

import argparse
import json
import os
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))
from relief import GAUSSIANS, drawn, save

from phy124.camera import Camera
from phy124.gaussians import Gaussians
from phy124.generators.ply_file import PlyFile, Reading
from phy124.generators.relief import relief
from phy124.rendering.render import Renderer
from support.truths import DISTANCE, FINE, FRONT, NARROW, OBJECTS, VIEWS, WIDE, truth
from support.truths import _placed as place_solid
from support.truths import _traced as trace

FOLDER = Path(os.environ.get("PHY124_OBJECTS", Path(__file__).parents[3] / "shared/objects"))
REAL = (
    "boat", "bob", "boot", "cat", "fish", "goathead", "hammer", "koala", "penguin", "spot", "sword",
    "teapot", "tree", "wingnut",
)  # fmt: skip
"""The real objects; the plant is a capture of a whole table."""
FRONTS = {"spot": "z", "boat": "x", "fish": "x", "hammer": "x", "sword": "x"}
"""Direction of each file that is seen as the front; the others' is -z. Long ones seen from their
end would reach behind the camera."""
AROUND = ((0, 0), (60, 0), (120, 0), (180, 0), (240, 0), (300, 0), (0, 80), (0, -80))
"""Views from which the surface of a solid is sampled, degrees."""
FIELDS = ("back", "iou", "chamfer", "normal")


@dataclass(frozen=True)
class Known:
    """An object whose every side is known; the longest side of its front silhouette is 1 m."""

    front: NDArray[np.uint8]
    """The input of `relief` [FRONT,FRONT,4]."""
    pictures: NDArray[np.float32]
    """Colour on white and alpha [V,SMALL,SMALL,4] from `VIEWS`; the fourth is from behind."""
    points: NDArray[np.float32]
    """Points of the surface [M,3], m; the depth is centred."""
    normals: NDArray[np.float32]
    """Unit normals of unknown sign [M,3]."""


def solid(name: str) -> Known:
    """Return a solid of `support.truths` with points on its surface."""
    made = truth(name)
    file = Path(tempfile.gettempdir()) / f"phy124-surfaces/{name.replace(' ', '_')}.npz"
    if not file.exists():
        file.parent.mkdir(exist_ok=True)
        placed = place_solid(OBJECTS[name])
        hits = [trace(placed, Camera.orbit(*v, DISTANCE, 72, fov_y=WIDE)) for v in AROUND]
        points = np.concatenate(hits)
        points = points[np.isfinite(points[:, 0])]
        steps = 2e-3 * np.eye(3)
        normals = np.stack([placed(points + e) - placed(points - e) for e in steps], axis=1)
        np.savez_compressed(file, points=points, normals=unit(normals))
    with np.load(file) as kept:
        return Known(made.front, made.pictures, kept["points"], kept["normals"])


@cache
def renderer() -> Renderer:
    """Return the renderer of all pictures."""
    return Renderer(device="cpu")


def real(name: str) -> Known:
    """Return a real object, scaled as `relief` will scale its front."""
    reading = Reading(up="-y", front=FRONTS.get(name, "-z"))
    file = PlyFile(str(FOLDER / f"{name}.splat"), reading)
    gaussians = file()
    for _ in range(3):
        rgba = front_of(gaussians, FRONT)
        rows, columns = (np.flatnonzero((rgba[..., 3] > 0.5).any(axis=k)) for k in (1, 0))
        focal = Camera.orbit(0, 0, DISTANCE, FRONT, fov_y=NARROW).focal
        low, high = (np.array([a[[0, -1]] for a in (columns, rows)]).T + [[0], [1]]) - FRONT / 2
        low, high = low / focal * DISTANCE, high / focal * DISTANCE
        depth = gaussians.means[:, 0]
        middle = np.array([depth.min() + depth.max(), low[0] + high[0], -low[1] - high[1]]) / 2
        scale = float((high - low).max())
        means = ((gaussians.means - middle) / scale).astype(np.float32)
        scales = (gaussians.scales / scale).astype(np.float32)
        gaussians = Gaussians(means, gaussians.quats, scales, gaussians.opacities, gaussians.sh)
    picture = np.round(255 * straight(front_of(gaussians, FRONT))).astype(np.uint8)
    pictures = np.stack([drawn(renderer(), gaussians, view) for view in VIEWS])
    return Known(picture, pictures, gaussians.means, flat_axes(gaussians))


def front_of(gaussians: Gaussians, size: int) -> NDArray[np.float32]:
    """Draw the front on white [size,size,4], at twice the size first."""
    camera = Camera.orbit(0, 0, DISTANCE, FINE * size, fov_y=NARROW)
    fine = renderer()(gaussians, camera, alpha=True)
    return fine.reshape(size, FINE, size, FINE, 4).mean(axis=(1, 3)).astype(np.float32)


def straight(rgba: NDArray) -> NDArray:
    """Return colours that were drawn on white without the white in half-transparent pixels."""
    alpha = rgba[..., 3:]
    rgb = (rgba[..., :3] - 1 + alpha) / np.maximum(alpha, 1e-6)
    return np.clip(np.concatenate([rgb, alpha], axis=2), 0, 1)


def flat_axes(gaussians: Gaussians) -> NDArray[np.float64]:
    """Return the axis of each Gaussian along which it is thinnest [N,3]."""
    turns = Rotation.from_quat(gaussians.quats[:, [1, 2, 3, 0]]).as_matrix()
    return np.take_along_axis(turns, gaussians.scales.argmin(axis=1)[:, None, None], axis=2)[..., 0]


def unit(vectors: NDArray) -> NDArray:
    """Return vectors [N,3] of length 1."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)


def compared(known: Known, made: Gaussians) -> tuple[dict[str, float], list[NDArray]]:
    """Return the figures of `relief`'s object, and pictures of its front, side and back."""
    low, high = made.means[:, 0].min(), made.means[:, 0].max()
    known_low, known_high = known.points[:, 0].min(), known.points[:, 0].max()
    # How far away the object is no picture says.
    shift = np.array([(known_low + known_high - low - high) / 2, 0, 0], np.float32)
    made = Gaussians(made.means + shift, made.quats, made.scales, made.opacities, made.sh)
    seen = [drawn(renderer(), made, view) for view in VIEWS]
    masks = [(a[..., 3] > 0.5, b[..., 3] > 0.5) for a, b in zip(seen, known.pictures, strict=True)]
    inside = known.pictures[3][..., 3] > 0.5
    error = np.mean((seen[3][inside, :3] - known.pictures[3][inside, :3]) ** 2)
    there, back = (scipy.spatial.KDTree(points) for points in (known.points, made.means))
    to_truth, nearest = there.query(made.means)
    to_made, other = back.query(known.points)
    flat = flat_axes(made)
    cosines = [
        np.abs((flat * known.normals[nearest]).sum(axis=1)),
        np.abs((flat[other] * known.normals).sum(axis=1)),
    ]
    angles = [np.degrees(np.arccos(np.clip(cosine, 0, 1))).mean() for cosine in cosines]
    figures = {
        "back": float(-10 * np.log10(error)),
        "iou": float(np.mean([(a & b).sum() / (a | b).sum() for a, b in masks])),
        "chamfer": float(50 * (to_truth.mean() + to_made.mean())),
        "normal": float(np.mean(angles)),
    }
    return figures, [drawn(renderer(), made, (0, 0)), seen[1], seen[3]]


def line(name: str, row: dict[str, float], before: dict[str, float] | None) -> str:
    """Return one line of the table."""
    digits = {"back": 1, "iou": 3, "chamfer": 2, "normal": 1}
    cells = []
    for field in FIELDS:
        old = f"{before[field]:.{digits[field]}f} | " if before else ""
        cells.append(f"{old}{row[field]:.{digits[field]}f}")
    return f"| {name} | {' | '.join(cells)} |"


def mean_of(rows: list[dict[str, float]]) -> dict[str, float]:
    """Return the mean of each figure."""
    return {field: float(np.mean([row[field] for row in rows])) for field in FIELDS}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--look")
    chosen = parser.parse_args()
    before = json.loads(chosen.against.read_text()) if chosen.against else {}
    names = [(name, solid) for name in OBJECTS]
    names += [(f"{name}, real", real) for name in REAL if FOLDER.is_dir()]
    options = {} if chosen.look is None else {"back_look": chosen.look}
    figures, rows = {}, []
    for name, read in names:
        if chosen.only and name not in chosen.only:
            continue
        known = read(name.removesuffix(", real"))
        made = relief(Image.fromarray(known.front), count=GAUSSIANS, **options)
        figures[name], pictures = compared(known, made)
        print(line(name, figures[name], before.get(name)), flush=True)
        small = Image.fromarray(known.front).resize(pictures[0].shape[1::-1])
        inputs = np.asarray(small) / 255
        inputs = inputs[..., :3] * inputs[..., 3:] + 1 - inputs[..., 3:]
        truths = [inputs, known.pictures[1][..., :3], known.pictures[3][..., :3]]
        made_row = np.concatenate([picture[..., :3] for picture in pictures], axis=1)
        rows.append(np.concatenate([np.concatenate(truths, axis=1), made_row]))
    for kind, wanted in (("solids", False), ("real", True)):
        kept = [name for name in figures if name.endswith("real") is wanted]
        if kept:
            old = mean_of([before[name] for name in kept]) if before else None
            print(line(f"mean of {kind}", mean_of([figures[name] for name in kept]), old))
    if before:
        for field, sign in (("back", 1), ("iou", 1), ("chamfer", -1), ("normal", -1)):
            changes = {
                name: sign * (figures[name][field] - before[name][field]) for name in figures
            }
            worst = min(changes, key=changes.__getitem__)
            print(
                f"{field}: mean {np.mean(list(changes.values())):+.3f}, worst {worst}",
                f"{changes[worst]:+.3f}; worse in {sum(v < 0 for v in changes.values())}",
            )
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1))
    if chosen.pictures:
        rows += [np.ones_like(rows[0])] * (-len(rows) % 4)
        sheet = [np.concatenate(rows[i : i + 4], axis=1) for i in range(0, len(rows), 4)]
        save(np.round(255 * np.clip(np.concatenate(sheet), 0, 1)).astype(np.uint8), chosen.pictures)


if __name__ == "__main__":
    main()
