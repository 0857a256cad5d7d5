"""A clip of a cube of Gaussians that falls freely."""

import numpy as np

from phy124.io.clip import Clip


def falling(count=5):
    """A clip of a cube of Gaussians that falls, and their places in the first frame."""
    rest = np.stack(np.meshgrid(*[np.linspace(0, 1, 4)] * 3), -1).reshape(-1, 3)
    times = np.arange(count) / 24
    means = rest[None] - 4.9 * times[:, None, None] ** 2 * [0, 0, 1]
    n = len(rest)
    turned = np.broadcast_to([1.0, 0, 0, 0], (count, n, 4))
    clip = Clip(means, turned, np.full((count, n, 3), 0.1), np.ones(n), np.zeros((n, 1, 3)), times)
    return clip, rest
