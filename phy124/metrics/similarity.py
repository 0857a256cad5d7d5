"""CLIP-T: the similarity of the CLIP embeddings of consecutive frames, by two published formulas.

The paper states neither the CLIP model nor the formula that it uses. The paper's values (about
0.99, higher is better) are assumed to be the mean cosine of consecutive frames, as in Gen-1 (Esser
et al. 2023). 4DGen (Yin et al. 2023, section 4.3) uses half the squared angle instead (about 0.01,
lower is better). Both formulas measure only similarity, so a frozen video has the best value.
"""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.metrics.pictures import to_unit
from phy124.runtime.installation import needs_extra
from phy124.weights.store import require

MODEL = "laion/CLIP-ViT-B-32-laion2B-s34B-b79K"
"""Name of the CLIP model that 4DGen uses; PhysGaussian's paper does not state the model."""
FORMULAS = {
    "cosine": "mean cosine of consecutive frames, higher is better",
    "distance": "4DGen: mean of 2 arcsin(|a - b| / 2)^2 of consecutive frames, lower is better",
}
MEAN = (0.48145466, 0.4578275, 0.40821073)
STD = (0.26862954, 0.26130258, 0.27577711)
Order = Literal["rgb", "bgr"]
"""Order of the colour channels in CLIP's input. CLIP was trained on RGB; 4DGen uses BGR."""


def cosine(embeddings: NDArray) -> float:
    """Return the mean cosine of consecutive rows of `embeddings [T,D]`."""
    return float(cosine_pairs(embeddings).mean())


def distance(embeddings: NDArray) -> float:
    """Return the mean of half the squared angle between consecutive rows of `embeddings [T,D]`."""
    return float(distance_pairs(embeddings).mean())


def cosine_pairs(embeddings: NDArray) -> NDArray[np.float64]:
    """Return the cosine of the angle between each row of an array and the next row [T-1]."""
    e = _normalise(embeddings)
    return (e[1:] * e[:-1]).sum(axis=1)


def distance_pairs(embeddings: NDArray) -> NDArray[np.float64]:
    """Return half the squared angle between each row of an array and the next row [T-1].

    The result is precise even for small angles.
    """
    e = _normalise(embeddings)
    chord = np.linalg.norm(e[1:] - e[:-1], axis=1)
    return 2 * np.arcsin(np.clip(chord / 2, 0, 1)) ** 2


def _normalise(embeddings: NDArray) -> NDArray[np.float64]:
    e = np.asarray(embeddings, dtype=np.float64)
    if e.ndim != 2 or len(e) < 2:
        raise ValueError(
            f"embeddings must have shape [T,D] with T of at least 2, but have shape {e.shape}"
        )
    return e / np.linalg.norm(e, axis=1, keepdims=True)


class ClipModel:
    """A CLIP model, which encodes images as embeddings."""

    def __init__(self, model: str = MODEL, *, order: Order = "rgb") -> None:
        """Load a CLIP model that is stored on this machine.

        Args:
            model: A folder, or the name of a model on huggingface.co that has been downloaded.
            order: Order of the colour channels in the model's input.

        Raises:
            InputError: The model is missing or not a CLIP model, or transformers is not installed.
        """
        self.name = model
        self.order: Order = order
        self._network = _load(model)
        self._size = int(self._network.config.image_size)

    def __call__(self, images: Iterable[NDArray]) -> NDArray[np.float64]:
        """Return the embeddings [T,D] of images [H,W,3] (uint8, or float in 0..1)."""
        import torch

        rows = []
        with torch.inference_mode():
            for image in images:
                pixels = torch.from_numpy(_pixels(image, self._size, self.order)[None])
                rows.append(self._network(pixel_values=pixels).image_embeds[0].double())
        return torch.stack(rows).numpy()


def _pixels(image: NDArray, size: int, order: Order) -> NDArray[np.float32]:
    """Return CLIP's input [3,S,S]: the shorter side is resized to S, and the centre is cropped."""
    picture = Image.fromarray((to_unit(image) * 255 + 0.5).astype(np.uint8))
    scale = size / min(picture.size)
    wide, high = (max(size, round(side * scale)) for side in picture.size)
    left, top = (wide - size) // 2, (high - size) // 2
    picture = picture.resize((wide, high), Image.Resampling.BICUBIC)
    values = np.asarray(picture.crop((left, top, left + size, top + size)), np.float32) / 255
    values = values[..., ::-1] if order == "bgr" else values
    return np.ascontiguousarray(((values - MEAN) / STD).transpose(2, 0, 1), dtype=np.float32)


def _load(model: str) -> Any:
    limit = "transformers is needed to run CLIP and is not installed."
    with needs_extra("eval", "clip-model", model, limit):
        from transformers import CLIPVisionModelWithProjection
    source: str | os.PathLike[str] = model
    if model == MODEL:
        source = require("clip")["model.safetensors"].parent
    elif Path(os.path.expanduser(model)).is_dir():
        source = Path(os.path.expanduser(model))
    try:
        # Nothing is downloaded here, and pickled files are refused.
        return CLIPVisionModelWithProjection.from_pretrained(
            source, local_files_only=True, use_safetensors=True
        ).eval()
    except (OSError, ValueError) as error:
        raise InputError(
            "clip-model",
            model,
            f"it is not a CLIP model that is stored on this machine "
            f"({str(error).splitlines()[0]}).",
            f"Give a folder with config.json and model.safetensors, or run `hf download {model}`.",
        ) from error
