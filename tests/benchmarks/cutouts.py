"""Which wrong cut-outs by GrabCut are told: a table per set of pictures whose objects are known.

python tests/benchmarks/cutouts.py                    the examples, each pasted on 8 backgrounds
python tests/benchmarks/cutouts.py PICTURES MASKS     pictures, and masks named alike (.png)
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.imaging.cutout import foreground
from phy124.imaging.image import open_image

RIGHT = 0.85
"""Overlap (intersection over union) with the true mask from which a cut-out is right."""
EXAMPLES = Path(__file__).parents[2] / "demo/examples"
SIDE = 400
"""Of the backgrounds, pixels."""
Known = tuple[str, Image.Image, NDArray[np.bool_]]
"""A name, a picture, and where its object is [H,W]."""


def main(*folders: str) -> None:
    """Print a row per picture, then how many of the right and the wrong ones are told."""
    counts = Counter()
    print("| picture | overlap | told |\n|---|--:|---|")
    for name, picture, mask in given(*map(Path, folders)) if folders else pasted():
        found = foreground(picture, "grabcut")
        solid = np.asarray(found.picture)[..., 3] > 127
        overlap = float((solid & mask).sum() / (solid | mask).sum())
        counts[overlap >= RIGHT, bool(found.warnings)] += 1
        print(f"| {name} | {overlap:.2f} | {' '.join(found.warnings)} |")
    for right, word in ((True, "right"), (False, "wrong")):
        told, silent = counts[right, True], counts[right, False]
        print(f"{told + silent} {word}: {told} told, {silent} not")


def given(pictures: Path, masks: Path) -> Iterator[Known]:
    """Pictures of a folder whose masks lie in another; a mask's transparency counts, if any."""
    for path in sorted(pictures.iterdir()):
        picture, mask = open_image(path), Image.open(masks / f"{path.stem}.png")
        shown = mask.getchannel("A") if mask.mode == "RGBA" else mask.convert("L")
        yield path.name, picture, np.asarray(shown.resize(picture.size)) > 127


def pasted() -> Iterator[Known]:
    """Every example on every background."""
    place = ((SIDE - 256) // 2,) * 2
    for path in sorted(EXAMPLES.glob("*.png")):
        for name, ground in backgrounds():
            example, mask = Image.open(path).convert("RGBA"), Image.new("L", ground.size)
            ground.paste(example, place, example)
            mask.paste(example.getchannel("A"), place)
            yield f"{path.stem} on {name}", ground, np.asarray(mask) > 127


def backgrounds() -> Iterator[tuple[str, Image.Image]]:
    """From a white one to a room full of things (scikit-image's pictures)."""
    from skimage import data

    y, x = np.mgrid[:SIDE, :SIDE][..., None] / SIDE
    grounds = {
        "white": np.full((SIDE, SIDE, 3), 250),
        "a gradient": x * (100, 0, 0) + y * (0, 80, -60) + (120, 130, 200),
        "gravel": data.gravel(),
        "grass": data.grass(),
        "brick": data.brick(),
        "wood": data.coffee()[:120, :120],
        "a field with a photographer": data.camera(),
        "a garage": data.stereo_motorcycle()[0],
    }
    for name, pixels in grounds.items():
        yield name, Image.fromarray(pixels.astype(np.uint8)).convert("RGB").resize((SIDE, SIDE))


if __name__ == "__main__":
    main(*sys.argv[1:])
