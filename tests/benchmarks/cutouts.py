"""Measures how well each method cuts objects out of pictures whose masks are known.

Without arguments, the program pastes each example object on 12 backgrounds and updates the tables
of docs/lab/cutouts.md. With two folders, it cuts out the pictures of the first folder and prints
the results. The masks in the second folder have the same names (.png).

    python tests/benchmarks/cutouts.py
    python tests/benchmarks/cutouts.py PICTURES MASKS
"""

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import distance_transform_edt

sys.path.insert(0, str(Path(__file__).parent))
from tables import DOCS, markdown, renew

from phy124.imaging import u2net
from phy124.imaging.cutout import Cutout, clean_edge, examine
from phy124.imaging.grabcut import grabcut
from phy124.imaging.image import open_image
from phy124.imaging.matting import decontaminate, fit_edge
from phy124.imaging.objects import keep_largest, search_around, select_object
from phy124.weights.store import require

Alpha = NDArray[np.uint8]
RIGHT = 0.85
"""Overlap (intersection over union) with the true mask from which a cut-out is right."""
EXAMPLES = Path(__file__).parents[2] / "demo/examples"
SIDE = 512
"""Side of the backgrounds [pixels]."""
NETWORK = u2net.load(require("u2netp")["u2netp.onnx"])


class Known(NamedTuple):
    """A picture whose object is known."""

    ground: str
    rgb: NDArray[np.uint8]
    alpha: Alpha
    object: NDArray[np.uint8] | None = None
    """The object's colours without the background [H,W,3], if they are known."""


def alone(rgb: NDArray[np.uint8]) -> Alpha:
    """The network's mask, enlarged as in rembg."""
    return u2net.foreground(rgb, NETWORK)


def shipped(rgb: NDArray[np.uint8]) -> Alpha:
    """The network's mask, fitted to the picture: the method `u2netp`."""
    return fit_edge(rgb, u2net.saliency(rgb, NETWORK))


def with_grabcut(rgb: NDArray[np.uint8]) -> Alpha:
    """As `shipped`, but where the network is in doubt GrabCut decides."""
    sure = u2net.saliency(rgb, NETWORK)
    small = cv2.resize(rgb, sure.shape[::-1], interpolation=cv2.INTER_AREA)
    labels = np.where(sure > 0.5, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[sure > 0.95], labels[sure < 0.05] = cv2.GC_FGD, cv2.GC_BGD
    cv2.setRNGSeed(0)
    models = np.zeros((1, 65)), np.zeros((1, 65))
    smooth = cv2.bilateralFilter(small, 5, 30, 3)
    cv2.grabCut(smooth, labels, (0, 0, 1, 1), *models, 2, cv2.GC_INIT_WITH_MASK)
    return fit_edge(rgb, (labels & 1).astype(np.float32))


def picked(known: Known) -> Alpha:
    """The result of `u2netp` at a point, the innermost point of the object."""
    depth = distance_transform_edt(known.alpha > 127)
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    place = (column + 0.5) / depth.shape[1], (row + 0.5) / depth.shape[0]

    def find(part: Image.Image) -> Alpha:
        return shipped(np.asarray(part.convert("RGB")))

    image = Image.fromarray(known.rgb)
    result = select_object(find(image), place)
    result = search_around(image, place, find) if result is None else result
    return np.zeros_like(known.alpha) if result is None else result


WAYS: dict[str, Callable[[NDArray[np.uint8]], Alpha]] = {
    "GrabCut": grabcut,
    "network alone": alone,
    "network, fitted (`u2netp`)": shipped,
    "network, GrabCut in doubt, fitted": with_grabcut,
}
PICKED = "`u2netp`, picked"
METHOD = {"GrabCut": "grabcut", "network, fitted (`u2netp`)": "u2netp"}
"""Ways that are methods of phy124."""


def main(*folders: str) -> None:
    """Measure, print, and of the examples renew the tables."""
    figures = Figures()
    for known in load_masked(*map(Path, folders)) if folders else pasted():
        figures.add(known)
    tables = {"overlap": figures.overlaps(), "doubts": figures.doubts()}
    if not folders:
        tables["halo"] = figures.halos()
    for name, table in tables.items():
        print(f"\n{table}")
        if not folders:
            renew(DOCS / "lab/cutouts.md", name, table)


class Figures:
    """The measurements of each method, picture by picture."""

    def __init__(self) -> None:
        self.overlap: dict[str, dict[str, list[float]]] = {way: {} for way in WAYS}
        self.error: dict[str, list[float]] = {way: [] for way in WAYS}
        self.seconds: dict[str, list[float]] = {way: [] for way in WAYS}
        self.warned: dict[str, Counter[tuple[bool, bool]]] = {way: Counter() for way in METHOD}
        self.picked: dict[str, list[float]] = {}
        self.halo: dict[str, list[float]] = {"with halo": [], "halo removed": []}

    def add(self, known: Known) -> None:
        """Cut a picture out in every way and compare."""
        true = known.alpha > 127
        for way, find in WAYS.items():
            start = time.process_time()
            alpha, objects = keep_largest(find(known.rgb))
            self.seconds[way].append(time.process_time() - start)
            overlap = overlap_of(alpha, known)
            self.overlap[way].setdefault(known.ground, []).append(overlap)
            self.error[way].append(np.abs(alpha / 255 - known.alpha / 255).sum() / true.sum())
            if way in METHOD:
                doubtful = bool(cut(known.rgb, alpha, METHOD[way], objects).warnings)
                self.warned[way][overlap >= RIGHT, doubtful] += 1
            if way == "network, fitted (`u2netp`)" and overlap >= RIGHT:
                self._add_halo(known, alpha)
        self.picked.setdefault(known.ground, []).append(overlap_of(picked(known), known))

    def _add_halo(self, known: Known, alpha: Alpha) -> None:
        if known.object is None:
            return
        clean = decontaminate(known.rgb, alpha)
        for name, shown in zip(self.halo, (known.rgb, clean), strict=True):
            self.halo[name].append(share_of_ground(known, shown, alpha))

    def overlaps(self) -> str:
        """Means per ground, and over all."""
        grounds = next(iter(self.overlap.values()))
        rows = [
            [
                ground,
                *(f"{np.mean(by[ground]):.3f}" for by in (*self.overlap.values(), self.picked)),
            ]
            for ground in (grounds if len(grounds) < 20 else ())
        ]
        columns = {**self.overlap, PICKED: self.picked}
        flat = {way: np.concatenate(list(by.values())) for way, by in columns.items()}
        sums = {
            "**mean of all**": lambda way: f"**{flat[way].mean():.3f}**",
            "median": lambda way: f"{np.median(flat[way]):.3f}",
            f"correct (over {RIGHT})": lambda way: (
                f"{(flat[way] > RIGHT).sum()} of {len(flat[way])}"
            ),
            "over 0.95": lambda way: f"{(flat[way] > 0.95).sum()}",
            "error of alpha, median": lambda way: format_median(self.error, way, 100, " %"),
            "processor time, median": lambda way: format_median(self.seconds, way, 1, " s"),
        }
        rows += [[name, *(text(way) for way in columns)] for name, text in sums.items()]
        return markdown(["ground", *columns], rows)

    def doubts(self) -> str:
        """Return how many correct and wrong cut-outs have a warning."""
        heads = [
            "method",
            "correct, with warning",
            "correct, without",
            "wrong, with warning",
            "wrong, without",
        ]
        kinds = ((True, True), (True, False), (False, True), (False, False))
        return markdown(
            heads,
            [[METHOD[way], *(count[kind] for kind in kinds)] for way, count in self.warned.items()],
        )

    def halos(self) -> str:
        """The ground's part in the colours of soft edges."""
        rows = [[name, f"{np.mean(v):.0%}", f"{np.max(v):.0%}"] for name, v in self.halo.items()]
        return markdown(
            ["colours of the soft edge", "fraction of the background, mean", "largest"], rows
        )


def format_median(figures: dict[str, list[float]], way: str, factor: float, unit: str) -> str:
    return f"{factor * np.median(figures[way]):.1f}{unit}" if way in figures else ""


def overlap_of(alpha: Alpha, known: Known) -> float:
    """Intersection over union with the true mask."""
    result, true = alpha > 127, known.alpha > 127
    return float((result & true).sum() / max(1, (result | true).sum()))


def cut(rgb: NDArray[np.uint8], alpha: Alpha, method: str, objects: int) -> Cutout:
    """As `phy124.imaging.cutout.foreground` gives it."""
    original = Image.fromarray(rgb)
    return examine(clean_edge(original, alpha), method, 1, objects, original=original)


def share_of_ground(known: Known, shown: NDArray[np.uint8], alpha: Alpha) -> float:
    """Return the fraction of the background's colour in the object's soft edge."""
    assert known.object is not None
    index = distance_transform_edt(known.alpha < 250, return_distances=False, return_indices=True)
    shares = known.object[tuple(index)].astype(float)
    ground = dict(grounds())[known.ground].astype(float)
    away = ground - shares
    soft = (alpha > 5) & (alpha < 250) & (np.linalg.norm(away, axis=2) > 40)
    share = ((shown - shares) * away).sum(axis=2)[soft] / (away**2).sum(axis=2)[soft]
    return float(np.average(share, weights=alpha[soft])) if soft.any() else 0.0


def load_masked(pictures: Path, masks: Path) -> Iterator[Known]:
    """Pictures of a folder whose masks lie in another; a mask's transparency counts, if any."""
    for path in sorted(pictures.iterdir()):
        if not (masks / f"{path.stem}.png").exists():
            continue
        picture, mask = open_image(path), Image.open(masks / f"{path.stem}.png")
        shown = mask.getchannel("A") if mask.mode == "RGBA" else mask.convert("L")
        rgb = np.asarray(picture.convert("RGB"))
        yield Known(path.name, rgb, np.asarray(shown.resize(picture.size)))


def pasted() -> Iterator[Known]:
    """Every example on every ground, at a size and a place drawn by lot."""
    rng = np.random.default_rng(0)
    for path in sorted(EXAMPLES.glob("*.png")):
        for name, ground in grounds():
            side = int(rng.uniform(0.4, 0.75) * SIDE)
            place = tuple(int(v) for v in rng.uniform(0.04, 0.96, 2) * (SIDE - side))
            example = Image.open(path).convert("RGBA").resize((side, side))
            layer = Image.new("RGBA", (SIDE, SIDE))
            layer.paste(example, place)
            whole = Image.alpha_composite(Image.fromarray(ground).convert("RGBA"), layer)
            pixels = np.asarray(layer)
            yield Known(name, np.asarray(whole.convert("RGB")), pixels[..., 3], pixels[..., :3])


@cache
def grounds() -> tuple[tuple[str, NDArray[np.uint8]], ...]:
    """From a white one to a room full of things (scikit-image's pictures)."""
    from skimage import data

    y, x = np.mgrid[:SIDE, :SIDE][..., None] / SIDE
    checks = ((8 * x).astype(int) + (8 * y).astype(int)) % 2 > 0
    known = {
        "white": np.full((SIDE, SIDE, 3), 250),
        "a gradient": x * (100, 0, 0) + y * (0, 80, -60) + (120, 130, 200),
        "stripes": 127 + 90 * np.sin(40 * (x + 0.4 * y)) * (1, 0.6, -0.7),
        "checks": np.where(checks, (200, 60, 40), (230, 220, 200)),
        "coloured clouds": _clouds(),
        "gravel": data.gravel(),
        "grass": data.grass(),
        "brick": data.brick(),
        "wood": data.coffee()[:120, :120],
        "the moon": data.moon(),
        "a field with a photographer": data.camera(),
        "a garage with a motorcycle": data.stereo_motorcycle()[0],
    }
    return tuple((name, _resized(pixels)) for name, pixels in known.items())


def _resized(pixels: NDArray) -> NDArray[np.uint8]:
    picture = Image.fromarray(np.clip(pixels, 0, 255).astype(np.uint8)).convert("RGB")
    return np.asarray(picture.resize((SIDE, SIDE)))


def _clouds() -> NDArray[np.float64]:
    rng, clouds = np.random.default_rng(0), np.zeros((SIDE, SIDE, 3))
    for octave, cells in enumerate((4, 9, 20, 60), 1):
        layer = rng.random((cells, cells, 3))
        clouds += cv2.resize(layer, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC) / octave
    return 255 * clouds / clouds.max()


if __name__ == "__main__":
    main(*sys.argv[1:])
