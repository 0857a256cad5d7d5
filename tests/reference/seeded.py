"""Seeded tensors, for which the original programs and phy124 compute the same outputs."""

import numpy as np


def seed_tensors(shapes, seed):
    """Tensors by name, rounded to float16, drawn in the order of their names.

    Weights have a variance that keeps activations near 1; scales of normalisations are near 1.
    numpy guarantees that `RandomState` draws the same numbers in every release.
    """
    rng, tensors = np.random.RandomState(seed), {}
    for name in sorted(shapes):
        shape = tuple(shapes[name])
        values = rng.standard_normal(shape)
        if len(shape) >= 2 and "embeddings" not in name:
            values *= 1.2 / np.sqrt(np.prod(shape[1:]))
        elif len(shape) == 1 and name.endswith("weight"):
            values = 1 + 0.1 * values
        else:
            values *= 0.3
        tensors[name] = values.astype(np.float16).astype(np.float32)
    return tensors


def draw_cutout(seed, height, width):
    """A noisy picture whose alpha is an ellipse with a soft edge."""
    rgba = np.random.RandomState(seed).randint(0, 256, (height, width, 4)).astype(np.uint8)
    y, x = np.mgrid[:height, :width]
    d = ((x - 0.57 * width) / (0.27 * width)) ** 2 + ((y - 0.46 * height) / (0.3 * height)) ** 2
    rgba[..., 3] = np.clip((1.3 - d) * 400, 0, 255).astype(np.uint8)
    return rgba
