"""A generator of your own: any function that returns Gaussians can replace the built-in ones."""

import numpy as np

import phy124
from phy124 import Gaussians
from phy124.generators import GENERATORS


def ball(image_rgba, *, seed, progress):
    """Return a ball of 4,000 Gaussians; the picture is ignored."""
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(4000, 3))
    means *= 0.48 / np.linalg.norm(means, axis=1, keepdims=True)
    quats, scales = np.tile([1, 0, 0, 0], (4000, 1)), np.full((4000, 3), 0.02)
    progress("ball", 1, 1)
    return Gaussians.from_rgb(means, quats, scales, np.full(4000, 0.9), 0.5 + means)


GENERATORS["ball"] = lambda: ball

if __name__ == "__main__":
    scene = phy124.Scene.named("bounce").replaced(
        {"accuracy": "draft", "time.frames": 30, "view.views": ["front"], "view.stage": "studio"}
    )
    phy124.generate("demo/examples/duck.png", scene, "out/generator", generator="ball")
