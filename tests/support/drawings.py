"""Plain pictures of simple objects, drawn for tests of `relief`."""

import numpy as np
from PIL import Image

SIZE = 192
Y, X = np.mgrid[:SIZE, :SIZE] + 0.5


def picture(mask, rgb=(200, 120, 60)):
    colours = np.broadcast_to(np.asarray(rgb, np.uint8), (*mask.shape, 3))
    return Image.fromarray(np.dstack([colours, 255 * mask.astype(np.uint8)]))


def face():
    """Draw a yellow disc with two black eyes away from the rim."""
    mask = np.hypot(X - 96, Y - 96) < 80
    eyes = np.minimum(np.hypot(X - 66, Y - 76), np.hypot(X - 126, Y - 76)) < 12
    rgb = np.where(eyes[..., None], 10, np.array([240, 200, 40])).astype(np.uint8)
    return picture(mask, rgb)


def mug():
    body = (abs(X - 75) < 45) & (abs(Y - 96) < 60)
    return picture(body | (abs(np.hypot(X - 120, Y - 96) - 36) < 9), (60, 90, 200))
