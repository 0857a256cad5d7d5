"""Draw docs/images/outputs.webp: the outputs of a pressed duck, with a row for each instant.

python docs/images/outputs.py    (simulates at draft; half a minute)
"""

import json
import tempfile
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from phy124 import pipeline
from phy124.scene import Scene

ROOT = Path(__file__).parents[2]
OUTPUTS = ("depth", "normals", "flow", "velocity", "force")
INSTANTS = (2, 5, 10)
SIDE = 200


def main() -> None:
    changes = {
        "accuracy": "draft", "view.views": ["front"], "view.azimuths": [], "view.size": SIDE,
        "view.formats": ["png"], "view.outputs": OUTPUTS, "view.distance": 1.6,
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "made"
        scene = Scene.named("press").replaced(changes)
        pipeline.generate(ROOT / "demo/examples/duck.png", scene, made)
        told = json.loads((made / "front-outputs/outputs.json").read_text())
        rows = [row(made, told, index) for index in INSTANTS]
    Image.fromarray(np.concatenate(rows)).save(ROOT / "docs/images/outputs.webp", quality=85)


def row(made: Path, told: dict, index: int) -> np.ndarray:
    with Image.open(made / f"front-png/front_{index + 1:04}.png") as opened:
        pictures = [np.asarray(opened.convert("RGB"))]
    files = told["frames"][index]["files"]
    for name in OUTPUTS:
        raw = cv2.imread(str(made / "front-outputs" / files[name]), cv2.IMREAD_UNCHANGED)
        raw = raw[..., None] if raw.ndim == 2 else raw[..., ::-1]
        about = told["outputs"][name]
        value = (raw[..., : len(about["channels"])].astype(float) - about["zero"]) * about["scale"]
        pictures.append(shown(name, value, raw.any(axis=2)))
    return np.concatenate(pictures, axis=1)


def shown(name: str, value: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Return an output as a picture.

    Small depths are bright. Vectors are colours around grey. Upward force is red, downward blue.
    """
    image = np.full((*covered.shape, 3), 1.0)
    if name == "depth":
        near, far = value[covered].min(), value[covered].max()
        image[covered] = 0.9 - 0.8 * (value[covered] - near) / (far - near)
    elif name == "force":
        up = value[..., 2] / np.abs(value[..., 2]).max()
        push, pull = (np.clip(sign * up, 0, 1)[..., None] for sign in (1, -1))
        image -= push * (0, 1, 1) + pull * (1, 1, 0)
    else:
        most = 1.0 if name == "normals" else np.abs(value[covered]).max()
        three = np.pad(value, [(0, 0), (0, 0), (0, 3 - value.shape[2])]) / most
        image[covered] = 0.5 + 0.5 * three[covered]
    return (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)


if __name__ == "__main__":
    main()
