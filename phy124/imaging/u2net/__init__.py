"""Segments the salient object with U2-Net (Qin et al. 2020).

The small network is part of this package; the full network must be downloaded. OpenCV runs .onnx
files, and torch runs .pth files.
"""

import os
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.imaging.gaps import open_gaps
from phy124.imaging.image import is_blank, normalise, reduce_size
from phy124.imaging.matting import fit_edge, resize
from phy124.imaging.silhouette import measure_alike, measure_undecided, measure_unseen
from phy124.runtime import isolated
from phy124.runtime.installation import install_command
from phy124.weights.store import KNOWN, WeightFile, find, require

SIZE = 320
"""Side of the network's input [pixels]."""
CLOSER = 1.4
"""A small object is segmented again only if this magnifies it by at least this factor."""
AROUND = 0.15
"""Width of the margin around a small object, relative to the object's longest side."""
AGREED = 0.85
"""Smallest overlap (IoU) of two masks that agree."""
BEYOND = 0.35
"""Width of the margin around a whole image, relative to the image's longest side."""
DOUBTFUL = 0.05
"""A mask away from the border is doubtful if `_measure_doubt` exceeds this value."""
SIDE = 640
"""Longest side of the reduced image in which masks are compared [pixels]."""
Network = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""Maps a normalised image [1,3,320,320] to the saliency [1,1,320,320] in 0..1."""


def weights_file() -> Path | None:
    """Return the file of the full U2-Net, or None; .onnx is preferred to .pth."""
    (onnx,) = KNOWN["u2net"]
    pth = WeightFile(onnx.repo, "u2net.pth", onnx.licence)
    return find(onnx) or find(pth)


def is_available(image: Image.Image | None = None) -> bool:
    """Whether the full U2-Net and the package that runs it are installed."""
    path = weights_file()
    return path is not None and (path.suffix == ".onnx" or find_spec("torch") is not None)


def find_alpha(
    image: Image.Image, deadline: isolated.Deadline = isolated.PATIENT
) -> NDArray[np.uint8]:
    """Return the alpha [H,W] of the salient object, found with the full U2-Net.

    Raises:
        InputError: The weight file is missing, or it is a .pth file and torch is not installed.
    """
    # `require` raises an error that lists the paths that were searched and the command that
    # downloads the file.
    return _run_isolated(image, weights_file() or require("u2net")["u2net.onnx"], deadline)


def find_alpha_small(
    image: Image.Image, deadline: isolated.Deadline = isolated.PATIENT
) -> NDArray[np.uint8]:
    """Return the alpha [H,W] of the salient object, found with the small U2-NetP."""
    return _run_isolated(image, require("u2netp")["u2netp.onnx"], deadline)


def _run_isolated(
    image: Image.Image, weights: Path, deadline: isolated.Deadline
) -> NDArray[np.uint8]:
    return isolated.run(_find_alpha, np.asarray(image.convert("RGB")), weights, deadline=deadline)


def _find_alpha(rgb: NDArray[np.uint8], weights: Path) -> NDArray[np.uint8]:
    if is_blank(rgb):
        # The network would report an object even in a blank image.
        return np.zeros(rgb.shape[:2], np.uint8)
    network = load(weights)
    coarse = look_beyond(rgb, saliency(rgb, network), network)
    return fit_edge(rgb, open_gaps(rgb, look_closer(rgb, coarse, network)))


def saliency(rgb: NDArray[np.uint8], network: Network) -> NDArray[np.float32]:
    """Return the probability [320,320] that the object covers each pixel of an image [H,W,3]."""
    return network(prepare_rembg(rgb))[0, 0]


def look_beyond(
    rgb: NDArray[np.uint8], coarse: NDArray[np.float32], network: Network
) -> NDArray[np.float32]:
    """Segment again, inside a margin, an object that the image's border may cut.

    The network often misses parts at the border. The colours of the border are therefore continued
    into a margin around the image [H,W,3]. If the second mask reaches the border and is less
    doubtful, it is returned [h,w]; otherwise the first mask [320,320] is returned.
    """
    width, height = size = reduce_size(rgb.shape, SIDE)
    small = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
    first = resize(coarse, size)
    doubt = _measure_doubt(small, first)
    if not _reaches_border(first) and doubt <= DOUBTFUL:
        return coarse
    margin = 1 + int(BEYOND * max(size))
    wider = np.pad(small, ((margin, margin), (margin, margin), (0, 0)), mode="edge")
    around = saliency(wider, network)
    second = resize(around, (width + 2 * margin, height + 2 * margin))
    second = second[margin:-margin, margin:-margin]
    is_better = _reaches_border(second) and _measure_doubt(small, second) < doubt
    return second if is_better else coarse


def _reaches_border(mask: NDArray[np.float32]) -> bool:
    return any(bool((side > 0.5).any()) for side in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))


def _measure_doubt(rgb: NDArray[np.uint8], mask: NDArray[np.float32]) -> float:
    """Return the sum of the measures of a mask [H,W] that are large for wrong masks."""
    solid, alpha = mask > 0.5, np.rint(255 * np.clip(mask, 0, 1)).astype(np.uint8)
    return measure_unseen(rgb, solid) + measure_alike(rgb, solid) + measure_undecided(alpha)


def look_closer(
    rgb: NDArray[np.uint8], coarse: NDArray[np.float32], network: Network
) -> NDArray[np.float32]:
    """Segment a small object again in a section of the image, so that thin parts cover more pixels.

    The first mask [h,w] is returned if the two masks disagree, or if the border cuts the object and
    the first mask is less doubtful; otherwise the mask [H,W] of the section.
    """
    height, width = rgb.shape[:2]
    whole = np.asarray(cv2.resize(coarse, (width, height)), np.float32)
    first = whole > 0.5
    if not first.any():
        return coarse
    rows, columns = np.flatnonzero(first.any(axis=1)), np.flatnonzero(first.any(axis=0))
    margin = int(AROUND * max(np.ptp(rows), np.ptp(columns)))
    top, bottom = int(rows[0]) - margin, int(rows[-1]) + margin
    left, right = int(columns[0]) - margin, int(columns[-1]) + margin
    if (
        CLOSER * max(bottom - top, right - left) > max(height, width)
        or min(bottom - top, right - left) < 2
    ):
        return coarse
    wider = np.pad(rgb, ((margin, margin), (margin, margin), (0, 0)), mode="edge")
    section = np.s_[top + margin : bottom + margin, left + margin : right + margin]
    near = saliency(np.ascontiguousarray(wider[section]), network)
    closer = np.zeros(wider.shape[:2], np.float32)
    closer[section] = resize(near, (right - left, bottom - top))
    closer = closer[margin : margin + height, margin : margin + width]
    second = closer > 0.5
    both = np.count_nonzero(first & second) / np.count_nonzero(first | second)
    if both < AGREED:
        return coarse
    if _reaches_border(closer) and _measure_doubt(rgb, closer) >= _measure_doubt(rgb, whole):
        return coarse
    return closer


def load(path: str | os.PathLike[str]) -> Network:
    """Load a network from a .onnx, .pth or .safetensors file.

    Raises:
        InputError: If the file is unreadable, does not contain a U2-Net, or needs torch and torch
            is not installed.
    """
    path = Path(path)
    try:
        return _load_onnx(path) if path.suffix == ".onnx" else _load_torch(path)
    except ImportError as error:
        raise InputError(
            "weights",
            path,
            f"{error.name} is needed to run this network and is not installed.",
            f"Run `{install_command('lgm')}`, or choose the foreground `u2netp`.",
        ) from error


def foreground(rgb: NDArray[np.uint8], network: Network) -> NDArray[np.uint8]:
    """Return the mask [H,W], 0..255, of the salient object, as rembg does."""
    return finish_rembg(network(prepare_rembg(rgb)), (rgb.shape[1], rgb.shape[0]))


def prepare_rembg(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Resample an image [H,W,3] to [1,3,320,320] as rembg does: Lanczos, divided by the maximum."""
    small = Image.fromarray(rgb).resize((SIZE, SIZE), Image.Resampling.LANCZOS)
    image = np.asarray(small, dtype=np.float64)
    return normalise(image / max(float(image.max()), 1e-6))


def finish_rembg(d0: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Convert the output [1,1,320,320] to a mask of the size (W, H), as rembg does."""
    d0 = d0[0, 0]
    low, high = float(d0.min()), float(d0.max())
    # A constant output means that no object is salient; the original program would divide by zero.
    unit = (d0 - low) / (high - low) if high > low else np.zeros_like(d0)
    small = Image.fromarray((np.clip(unit, 0, 1) * 255).astype(np.uint8))
    return np.asarray(small.resize(size, Image.Resampling.LANCZOS))


def multiply_mask(image: NDArray[np.uint8], mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Multiply all channels of an image by the mask, as rembg does; return [H,W,4].

    LGM's program multiplies the colours of such images by alpha again, which darkens soft edges.
    """
    picture = Image.fromarray(image).convert("RGBA")
    clear = Image.new("RGBA", picture.size, 0)
    return np.asarray(Image.composite(picture, clear, Image.fromarray(mask)))


def _load_onnx(path: Path) -> Network:
    try:
        # The file is passed as bytes, because OpenCV cannot open files with some names.
        network = cv2.dnn.readNetFromONNX(np.frombuffer(path.read_bytes(), np.uint8))
        first = network.getUnconnectedOutLayersNames()[0]
    except (cv2.error, OSError, IndexError) as error:
        raise InputError(
            "weights",
            path,
            f"the file is not a readable ONNX network ({str(error).strip().splitlines()[-1]}).",
            "Delete the file and run `phy124 weights fetch u2net`.",
        ) from error

    def run(x: NDArray[np.float32]) -> NDArray[np.float32]:
        network.setInput(x)
        # Without a name, OpenCV 4 returns the last of the seven outputs, not the first.
        return np.asarray(network.forward(first), np.float32)

    return run


def _load_torch(path: Path) -> Network:
    import torch

    from phy124.imaging.u2net.network import load as build
    from phy124.weights.checkpoints import read_tensors

    network = build(read_tensors(path))

    def run(x: NDArray[np.float32]) -> NDArray[np.float32]:
        with torch.inference_mode():
            return network(torch.from_numpy(x))[0].numpy()

    return run
