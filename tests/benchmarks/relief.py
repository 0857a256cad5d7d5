"""Compares `relief` with solids that are known from all sides: `python tests/benchmarks/relief.py`.

Each solid is drawn from the front, and `relief` makes an object from this picture. Object and solid
are compared from eight other sides (`support.truths.VIEWS`): the overlap of the silhouettes (IoU),
the pictures on white (PSNR), and the depth and volume of the filled object.

`--only NAME...` selects some solids, and `--flat` selects flat objects instead. With `--depth`,
`--side` and `--back`, `relief` also uses the true depth map or true pictures of these sides.
`--pictures FILE` writes the compared pictures (truth above), and `--json FILE` the figures.
`--against FILE` shows the change relative to an earlier file. `--examples FILE` draws the objects
made from demo/examples from all sides.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1]))
from phy124.camera import Camera
from phy124.gaussians import Gaussians
from phy124.generators.relief import relief
from phy124.particles.seeding import fill
from phy124.rendering.render import Renderer
from support.truths import DISTANCE, FLAT, OBJECTS, SMALL, VIEWS, WIDE, Truth, truth

EXAMPLES = Path(__file__).parents[2] / "demo" / "examples"
GAUSSIANS = 15_000
MEANS, RATIOS = ("iou", "side", "psnr", "seconds"), ("depth", "volume")
SPACING = 0.02
"""Spacing of the particles that measure the volume, m."""


def compared(truth: Truth, gaussians: Gaussians, renderer: Renderer) -> tuple[dict, np.ndarray]:
    """Figures, and the pictures [V,SMALL,SMALL,3]."""
    low, high = gaussians.means.min(axis=0), gaussians.means.max(axis=0)
    # How far away the object is no picture says.
    there = gaussians.means - np.array([low[0] + high[0], 0, 0], np.float32) / 2
    placed = Gaussians(there, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)
    seen, overlaps, errors = [], [], []
    for view, wanted in zip(VIEWS, truth.pictures, strict=True):
        rgba = drawn(renderer, placed, view)
        inside, right = rgba[..., 3] > 0.5, wanted[..., 3] > 0.5
        overlaps.append((inside & right).sum() / (inside | right).sum())
        seen.append(rgba[..., :3])
        errors.append(-10 * np.log10(np.mean((seen[-1] - wanted[..., :3]) ** 2)))
    volume = len(fill(placed, SPACING)) * SPACING**3
    figures = {
        "iou": float(np.mean(overlaps)),
        "side": float(overlaps[1]),
        "psnr": float(np.mean(errors)),
        "depth": float(high[0] - low[0]) / truth.depth,
        "volume": volume / truth.volume,
    }
    return figures, np.stack(seen)


def drawn(renderer: Renderer, gaussians: Gaussians, view: tuple[float, float]) -> np.ndarray:
    """Picture [SMALL,SMALL,4]: at twice the size first, since drawing widens splats by a pixel."""
    camera = Camera.orbit(*view, DISTANCE, 2 * SMALL, fov_y=WIDE)
    fine = renderer(gaussians, camera, alpha=True)
    return fine.reshape(SMALL, 2, SMALL, 2, 4).mean(axis=(1, 3))


def measured(name: str, renderer: Renderer, more: Sequence[str] = ()) -> tuple[dict, np.ndarray]:
    """Figures of one object and what was compared, as one picture: truth above, relief below.

    `more` says what `relief` gets beside the front: depth, side, back.
    """
    known = truth(name)
    start, options = (
        time.perf_counter(),
        {key: getattr(known, key) for key in more if key != "depth"},
    )
    if "depth" in more:
        near = np.nan_to_num(known.distances, nan=-1.0)
        options["depth"] = np.round(200 * near)  # as 8 bits would hold it
    gaussians = relief(Image.fromarray(known.front), count=GAUSSIANS, **options)
    seconds = time.perf_counter() - start
    figures, seen = compared(known, gaussians, renderer)
    front = drawn(renderer, gaussians, (0, 0))[..., :3]
    rows = [front_picture(known), *known.pictures[..., :3]], [front, *seen]
    sheet = np.concatenate([np.concatenate(row, axis=1) for row in rows])
    return {**figures, "seconds": seconds}, np.round(255 * np.clip(sheet, 0, 1)).astype(np.uint8)


def front_picture(truth: Truth) -> np.ndarray:
    """The picture that `relief` gets, on white."""
    small = Image.fromarray(truth.front).resize((SMALL, SMALL))  # weighs by alpha
    rgba = np.asarray(small) / 255
    return rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]


def summary(figures: dict[str, dict]) -> dict[str, float]:
    """Means, and medians of the ratios."""
    columns = {key: [row[key] for row in figures.values()] for key in (*MEANS, *RATIOS)}
    means = {key: float(np.mean(columns[key])) for key in MEANS}
    return means | {key: float(np.median(columns[key])) for key in RATIOS}


def line(name: str, row: dict, before: dict | None) -> str:
    """One line of the table, also of the one in docs/lab/relief.md."""
    old = f"{before['iou']:.3f} | {before['psnr']:.1f} | {before['depth']:.2f} | " if before else ""
    return (
        f"| {name} | {old}{row['iou']:.3f} | {row['psnr']:.1f} | {row['depth']:.2f} | "
        f"{row['side']:.3f} | {row['volume']:.2f} |"
    )


def turntables(renderer: Renderer) -> np.ndarray:
    """Draw the object of each picture in demo/examples from all sides."""
    rows = []
    for file in sorted(EXAMPLES.glob("*.png")):
        made = relief(Image.open(file))
        rows.append([drawn(renderer, made, view)[..., :3] for view in ((0, 0), *VIEWS)])
    sheet = np.concatenate([np.concatenate(row, axis=1) for row in rows])
    return np.round(255 * np.clip(sheet, 0, 1)).astype(np.uint8)


def save(sheet: np.ndarray, file: Path) -> None:
    """Save a picture in the format of its file name; a WebP of this quality is small."""
    Image.fromarray(sheet).save(file, quality=80)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=list(OBJECTS))
    parser.add_argument("--flat", dest="only", action="store_const", const=list(FLAT))
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--examples", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--depth", dest="more", action="append_const", const="depth")
    parser.add_argument("--side", dest="more", action="append_const", const="side")
    parser.add_argument("--back", dest="more", action="append_const", const="back")
    chosen = parser.parse_args()
    before = json.loads(chosen.against.read_text()) if chosen.against else {}
    renderer, figures, sheets = Renderer(device="cpu"), {}, []
    if chosen.examples:
        save(turntables(renderer), chosen.examples)
        return
    for name in chosen.only:
        figures[name], sheet = measured(name, renderer, chosen.more or ())
        sheets.append(sheet)
        print(line(name, figures[name], before.get(name)), flush=True)
    old = {name: before[name] for name in figures} if before else None
    print(line("mean, median", summary(figures), old and summary(old)))
    print(f"{summary(figures)['seconds']:.2f} s each")
    if before:
        worst = min(figures, key=lambda name: figures[name]["iou"] - before[name]["iou"])
        print(f"worst: {worst} {figures[worst]['iou'] - before[worst]['iou']:+.3f}")
    if chosen.json:
        chosen.json.write_text(json.dumps(figures, indent=1))
    if chosen.pictures:
        save(np.concatenate(sheets), chosen.pictures)


if __name__ == "__main__":
    main()
