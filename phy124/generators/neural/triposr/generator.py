"""The generator TripoSR: turns a segmented image into a density field, then into Gaussians.

Tochilkin et al. 2024. The network runs in onnxruntime if ONNX files are installed, or else in torch
from the public checkpoint.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.neural.triposr.field import Field
from phy124.generators.neural.triposr.surface import COUNT, cover_field
from phy124.generators.options import Effort
from phy124.generators.ply_file import normalise_size
from phy124.progress import Progress, silent
from phy124.weights.catalogue import ABOUT
from phy124.weights.onnx import OnnxNetwork, predict_seconds
from phy124.weights.store import is_complete, require

SIZE = 512
"""Side of the network's input [pixels]."""
RATIO = 0.85
"""Longest side of the object, relative to the input."""
GREY = 0.5
"""Colour behind the object."""
SETS = ("triposr", "triposr-int8", "triposr-torch")
"""Sets of weights in order of preference.

In the first set, the weights are int8. In the second set, weights and activations are int8. The
third set is float32 and runs in torch.
"""
Image_ = Image.Image | NDArray[np.uint8]


class TripoSrGenerator:
    """Turns an image into Gaussians; weights are loaded on the first call and stay in memory.

    Args:
        weights: Folder of the weights; None: the default folder of `phy124.weights.store`.
        field: Maps an image [1,3,512,512] to a field, instead of the network.
    """

    def __init__(
        self, *, weights: str | os.PathLike[str] | None = None, field: Any | None = None
    ) -> None:
        self.weights, self.field = weights, field

    def __call__(
        self, image_rgba: Image_, *, seed: int = 0, progress: Progress = silent, count: int = COUNT
    ) -> Gaussians:
        """Make Gaussians of the segmented image [H,W,4], with a longest side of 1 m.

        The object faces +x, because the network's first camera stands on +x, and z is up.

        Raises:
            InputError: If weights are missing, nothing is opaque, or the network finds no object.
        """
        image = prepare(frame(np.asarray(image_rgba)))
        progress("triposr", 0, 1)
        self.field = self.field or load_field(self.weights)
        field = self.field(image)
        progress("triposr", 1, 1)
        gaussians = cover_field(
            field,
            seed=seed,
            count=count,
            step=lambda done, total: progress("triposr surface", done, total),
        )
        return normalise_size(gaussians, "TripoSR")

    def effort(self) -> Effort:
        """Predict the run time for one object."""
        name = choose_set(self.weights)
        about = ABOUT[name]
        words = f"{PRECISIONS[name]} on the CPU, about {about.memory / 1e9:.1f} GB of memory"
        settings = {"weights": name, "memory": about.memory}
        return Effort(predict_seconds(about) or 0.0, settings, words)


PRECISIONS = {
    "triposr": "8-bit weights in onnxruntime",
    "triposr-int8": "8-bit weights and activations in onnxruntime",
    "triposr-torch": "float32 in torch",
}


def choose_set(folder: str | os.PathLike[str] | None = None) -> str:
    """Return the first complete set of weights, or the first set if all are incomplete."""
    return next((name for name in SETS if is_complete(name, folder)), SETS[0])


def load_field(folder: str | os.PathLike[str] | None = None) -> Any:
    """Return a function that maps an image [1,3,512,512] to a `Field`.

    Raises:
        InputError: If weights are missing or are not TripoSR's.
    """
    name = choose_set(folder)
    paths = require(name, folder)
    if name == "triposr-torch":
        return load_torch(paths["model.ckpt"])
    if name == "triposr":
        return load_onnx(paths["triplane_q8.onnx"], paths["decoder.onnx"])
    return load_onnx(paths["triposr_encoder_int8.onnx"], paths["triposr_decoder.onnx"])


def load_onnx(encoder: Path, decoder: Path) -> Any:
    """Load the ONNX files of the encoder and of the decoder.

    The encoder is loaded for each image and then released, because it takes most of the memory.

    Raises:
        InputError: If onnxruntime is not installed, or a file is unreadable or has another network.
    """
    decode = OnnxNetwork(decoder, None, RESULTS)
    return lambda image: _onnx_field(OnnxNetwork(encoder, ["image"], folds=False)(image)[0], decode)


RESULTS = ("density", "color")
"""Outputs of the decoders: density (after the exponential), and colour in 0..1."""


def _onnx_field(triplane: NDArray[np.float32], decode: OnnxNetwork) -> Field:
    planes = triplane[0]
    if decode.inputs == ["features"]:

        def decode_features(points: NDArray, features: NDArray) -> tuple[NDArray, NDArray]:
            density, colour = decode(features)
            return density, colour

        return Field(planes, decode_features)

    def decode_points(points: NDArray, features: NDArray) -> tuple[NDArray, NDArray]:
        density, colour = decode(triplane, points[None])
        return density[0], colour[0]

    return Field(planes, decode_points, samples=False)


def load_torch(path: Path) -> Any:
    """Load the public checkpoint in torch.

    Raises:
        InputError: If the file is not TripoSR's checkpoint.
    """
    import torch

    from phy124.generators.neural.triposr.network import load
    from phy124.weights.checkpoints import read_tensors

    network = load(read_tensors(path))

    def make_field(image: NDArray[np.float32]) -> Field:
        with torch.inference_mode():
            triplane = network(torch.from_numpy(image))[0].numpy()

        def decode(points: NDArray, features: NDArray) -> tuple[NDArray, NDArray]:
            with torch.inference_mode():
                density, colour = network.decoder(torch.from_numpy(features))
            return density.numpy(), colour.numpy()

        return Field(triplane, decode)

    return make_field


def frame(image_rgba: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Centre a segmented image [H,W,4] in a grey square [S,S,3].

    As in the original program, the bounding box lacks the object's last row and column.

    Raises:
        InputError: If there is no alpha channel or nothing is opaque.
    """
    if image_rgba.ndim != 3 or image_rgba.shape[2] != 4:
        remedy = "Cut it out first."
        raise InputError("image", list(image_rgba.shape), "a cut-out has four channels.", remedy)
    rows, columns = np.nonzero(image_rgba[..., 3])
    if len(rows) == 0 or np.ptp(rows) == 0 or np.ptp(columns) == 0:
        remedy = "Choose another picture or another way to cut the object out."
        raise InputError("image", "cut-out", "it shows no object.", remedy)
    cut = image_rgba[rows.min() : rows.max(), columns.min() : columns.max()]
    height, width = cut.shape[:2]
    longest = max(height, width)
    side = int(longest / RATIO)
    top, left = (side - longest) // 2 + (longest - height) // 2, (side - longest) // 2
    left += (longest - width) // 2
    framed = np.zeros((side, side, 4), np.float32)
    framed[top : top + height, left : left + width] = cut.astype(np.float32) / 255
    rgb, alpha = framed[..., :3], framed[..., 3:]
    return ((rgb * alpha + (1 - alpha) * GREY) * 255).astype(np.uint8)


def prepare(rgb: NDArray[np.uint8], size: int = SIZE) -> NDArray[np.float32]:
    """Resize an image [S,S,3]; return colours [1,3,size,size] in 0..1.

    The bilinear filter is wider if the image shrinks, as in the original program.
    """
    channels = [
        Image.fromarray(rgb[..., i].astype(np.float32) / 255).resize(
            (size, size), Image.Resampling.BILINEAR
        )
        for i in range(3)
    ]
    return np.stack([np.asarray(channel) for channel in channels])[None]
