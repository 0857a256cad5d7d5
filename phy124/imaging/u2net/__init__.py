"""Foreground by U2-Net: a mask of the salient object, computed as the original or rembg does.

Qin et al. 2020. The weights are a .onnx file (run by onnxruntime) or a .pth file (run by our own
torch module); either library is imported only when used.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.runtime import isolated
from phy124.runtime.installation import install_command
from phy124.weights.store import KNOWN, WeightFile, find, require

SIZE = 320
"""Side of the network's input, pixels."""
MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
Network = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""Normalised picture [1,3,320,320] -> saliency [1,1,320,320] in 0..1."""
Style = Literal["rembg", "original"]
"""Whose resampling is used: rembg's Lanczos (the default) or the authors' bilinear."""


def weights_file(folder: str | os.PathLike[str] | None = None) -> Path | None:
    """The best U2-Net file found (full before small, .onnx before .pth), or None."""
    for name in ("u2net", "u2netp"):
        (onnx,) = KNOWN[name]
        pth = WeightFile(onnx.repo, f"{name}.pth", onnx.licence)
        for file in (onnx, pth):
            if path := find(file, folder):
                return path
    return None


def available(image: Image.Image | None = None) -> bool:
    """Whether weights are found and the library that runs them is installed."""
    del image
    path = weights_file()
    return path is not None and find_spec(_library(path)) is not None


def alpha(image: Image.Image, deadline: isolated.Deadline = isolated.PATIENT) -> NDArray[np.uint8]:
    """Mask [H,W], 0..255, of the salient object in a picture, using the weights that are found.

    Raises:
        InputError: If there are no weights, or their library is not installed.
    """
    # `require` says where it was looked for and how to get it.
    path = weights_file() or require("u2net")["u2net.onnx"]
    return isolated.run(_alpha, np.asarray(image.convert("RGB")), path, deadline=deadline)


def _alpha(rgb: NDArray[np.uint8], weights: Path) -> NDArray[np.uint8]:
    return foreground(rgb, load(weights))


def _library(path: Path) -> str:
    return "onnxruntime" if path.suffix == ".onnx" else "torch"


def load(path: str | os.PathLike[str]) -> Network:
    """A network from a .onnx, .pth or .safetensors file.

    Raises:
        InputError: If the file is unreadable or not a U2-Net, or its library is not installed.
    """
    path = Path(path)
    try:
        return _onnx(path) if path.suffix == ".onnx" else _torch(path)
    except ImportError as error:
        raise InputError(
            "weights",
            path,
            f"{error.name} is needed to run it and is not installed.",
            f"Run `{install_command('lgm')}`, or choose the foreground `grabcut`.",
        ) from error


def foreground(
    rgb: NDArray[np.uint8], network: Network, *, style: Style = "rembg"
) -> NDArray[np.uint8]:
    """Mask [H,W], 0..255, of the salient object in `rgb [H,W,3]`."""
    prepare, finish = STYLES[style]
    return finish(network(prepare(rgb)), (rgb.shape[1], rgb.shape[0]))


def rembg_input(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """[1,3,320,320] of `rgb [H,W,3]`: Lanczos, divided by the largest value, normalised."""
    small = Image.fromarray(rgb).resize((SIZE, SIZE), Image.Resampling.LANCZOS)
    return _normalised(np.asarray(small, dtype=np.float64))


def original_input(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """[1,3,320,320] as the authors' program makes it: bilinear, blurred before shrinking.

    As there, everything outside the picture is black, which darkens the pixels at its edges a
    little.
    """
    from scipy.ndimage import gaussian_filter, zoom

    factors = np.array([rgb.shape[0] / SIZE, rgb.shape[1] / SIZE, 1.0])
    sigma = np.maximum(0, (factors - 1) / 2)
    smooth = gaussian_filter(rgb / 255, sigma, mode="grid-constant")
    small = zoom(smooth, 1 / factors, order=1, mode="grid-constant", grid_mode=True)
    return _normalised(np.asarray(small, dtype=np.float64))


def _normalised(image: NDArray[np.float64]) -> NDArray[np.float32]:
    image = image / max(float(image.max()), 1e-6)
    normal = (image - np.array(MEAN)) / np.array(STD)
    return np.ascontiguousarray(normal.transpose(2, 0, 1)[None], dtype=np.float32)


def rembg_mask(d0: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Mask [H,W] of the network's answer [1,1,320,320]; `size` is (W, H)."""
    return _stretched(d0, size, Image.Resampling.LANCZOS)


def original_mask(d0: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.uint8]:
    """As `rembg_mask` with the authors' bilinear enlargement."""
    return _stretched(d0, size, Image.Resampling.BILINEAR)


def _stretched(
    d0: NDArray[np.float32], size: tuple[int, int], resampling: Image.Resampling
) -> NDArray[np.uint8]:
    d0 = d0[0, 0]
    low, high = float(d0.min()), float(d0.max())
    # A constant answer says nothing stands out; the originals divide by zero here.
    unit = (d0 - low) / (high - low) if high > low else np.zeros_like(d0)
    small = Image.fromarray((np.clip(unit, 0, 1) * 255).astype(np.uint8))
    return np.asarray(small.resize(size, resampling))


STYLES = {
    "rembg": (rembg_input, rembg_mask),
    "original": (original_input, original_mask),
}


def smoothed(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A hard mask, 0 or 255, with specks removed: rembg's `post_process_mask`."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))
    opened = cv2.morphologyEx(mask, cv2.MORPH_OPEN, disc)
    blurred = cv2.GaussianBlur(opened, (7, 7), 2)
    return np.where(blurred < 128, 0, 255).astype(np.uint8)


def cut_out(image: NDArray[np.uint8], mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """[H,W,4] of `image [H,W,3 or 4]` with all channels multiplied by the mask, as rembg gives it.

    LGM was used with such pictures and multiplies once more, which darkens soft edges.
    """
    picture = Image.fromarray(image).convert("RGBA")
    clear = Image.new("RGBA", picture.size, 0)
    return np.asarray(Image.composite(picture, clear, Image.fromarray(mask)))


def _onnx(path: Path) -> Network:
    import onnxruntime

    try:
        session = onnxruntime.InferenceSession(path, providers=_providers(onnxruntime))
    except Exception as error:  # onnxruntime raises classes of its own, not exported
        raise InputError(
            "weights",
            path,
            f"the file is not a readable ONNX network ({str(error).splitlines()[0]}).",
            "Delete it and run `phy124 weights fetch u2net`.",
        ) from error
    (name,) = (entry.name for entry in session.get_inputs())
    return lambda x: np.asarray(session.run(None, {name: x})[0])


def _providers(onnxruntime: object) -> list[str]:
    wanted = ("CUDAExecutionProvider", "CPUExecutionProvider")
    have = onnxruntime.get_available_providers()  # pyright: ignore[reportAttributeAccessIssue]
    return [name for name in wanted if name in have]


def _torch(path: Path) -> Network:
    import torch

    from phy124.imaging.u2net.network import load as build
    from phy124.weights.checkpoints import read_tensors

    network = build(read_tensors(path))

    def run(x: NDArray[np.float32]) -> NDArray[np.float32]:
        with torch.inference_mode():
            return network(torch.from_numpy(x))[0].numpy()

    return run
