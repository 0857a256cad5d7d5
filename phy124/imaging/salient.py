"""Segments the salient object with trained networks from ONNX files: BiRefNet-lite and IS-Net.

Zheng et al. 2024, "Bilateral Reference for High-Resolution Dichotomous Image Segmentation"; Qin et
al. 2022, "Highly Accurate Dichotomous Image Segmentation". The masks already have soft edges, so
they are not refined.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.imaging.image import MEAN, STD, is_blank, normalise
from phy124.imaging.matting import resize
from phy124.runtime import isolated
from phy124.runtime.memory import free_memory
from phy124.weights.catalogue import ABOUT
from phy124.weights.onnx import OnnxNetwork
from phy124.weights.store import is_complete, require

Pixels = NDArray[np.uint8]
Mask = NDArray[np.float32]
SPARE = 0.8
"""Largest fraction of the free memory that a network may use if it is chosen by "auto"."""


@dataclass(frozen=True)
class Salient:
    """A network that maps an image to a mask of its salient object."""

    weights: str
    size: int
    resize: Callable[[Pixels, int], Pixels]
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
    """Mean and standard deviation for colours in 0..1."""
    finish: Callable[[Mask, tuple[int, int]], Mask]
    """Maps the network's output and the size (W, H) to a mask [H,W], 0..1."""
    title: str


def resize_smoothly(rgb: Pixels, size: int) -> Pixels:
    """Resize an image to a square with a bilinear filter; large images are smoothed."""
    return np.asarray(Image.fromarray(rgb).resize((size, size), Image.Resampling.BILINEAR))


def resize_sharply(rgb: Pixels, size: int) -> Pixels:
    """Resize an image to a square by bilinear interpolation, without smoothing; round down."""
    fine = cv2.resize(rgb.astype(np.float32), (size, size), interpolation=cv2.INTER_LINEAR)
    return np.floor(np.asarray(fine) + 1e-3).astype(np.uint8)


def finish_logits(logits: Mask, size: tuple[int, int]) -> Mask:
    """Convert a network's logits to probabilities in the image's size."""
    return resize((0.5 * (1 + np.tanh(0.5 * logits))).astype(np.float32), size)


def finish_stretched(values: Mask, size: tuple[int, int]) -> Mask:
    """Resize a network's output to the image's size, then stretch its values to the range 0..1.

    If all values are equal, no object is salient, and zeros are returned.
    """
    values = resize(values, size)
    low, high = float(values.min()), float(values.max())
    return (values - low) / (high - low) if high > low else np.zeros_like(values)


CENTRED = ((0.5, 0.5, 0.5), (1.0, 1.0, 1.0))
NETWORKS: dict[str, Salient] = {
    "birefnet": Salient(
        "birefnet-lite", 1024, resize_smoothly, MEAN, STD, finish_logits, "BiRefNet-lite"
    ),
    "birefnet-512": Salient(
        "birefnet-lite-512",
        512,
        resize_smoothly,
        MEAN,
        STD,
        finish_logits,
        "BiRefNet-lite at 512 pixels",
    ),
    "isnet": Salient("isnet", 1024, resize_sharply, *CENTRED, finish_stretched, "IS-Net"),
}
"""Networks by the name of the segmentation method."""


def is_available(name: str, image: Image.Image | None = None) -> bool:
    """Whether the weights of a network and onnxruntime are present, and enough memory is free."""
    weights = NETWORKS[name].weights
    complete = find_spec("onnxruntime") is not None and is_complete(weights)
    return complete and ABOUT[weights].memory < SPARE * free_memory()


def find_alpha(
    name: str, image: Image.Image, deadline: isolated.Deadline = isolated.PATIENT
) -> Pixels:
    """Return the alpha [H,W] of an image's salient object.

    Raises:
        InputError: The weights or onnxruntime are missing, or the file is of another network.
    """
    (path,) = require(NETWORKS[name].weights).values()
    rgb = np.asarray(image.convert("RGB"))
    return isolated.run(_find_alpha, name, rgb, path, deadline=deadline)


def _find_alpha(name: str, rgb: Pixels, path: Path) -> Pixels:
    if is_blank(rgb):
        # networks report an object even in a blank image
        return np.zeros(rgb.shape[:2], np.uint8)
    return find_mask(rgb, NETWORKS[name], OnnxNetwork(path))


def find_mask(rgb: Pixels, network: Salient, run: OnnxNetwork) -> Pixels:
    """Return the mask [H,W], 0..255, of the salient object in an image [H,W,3]."""
    (output,) = run(prepare(rgb, network))
    output = np.asarray(output, np.float32).reshape(output.shape[-2:])
    mask = network.finish(output, (rgb.shape[1], rgb.shape[0]))
    return np.rint(255 * np.clip(mask, 0, 1)).astype(np.uint8)


def prepare(rgb: Pixels, network: Salient) -> NDArray[np.float32]:
    """Resize and normalise an image [H,W,3]; return [1,3,size,size]."""
    return normalise(network.resize(rgb, network.size) / 255, network.mean, network.std)
