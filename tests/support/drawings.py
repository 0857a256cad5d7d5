"""Plain pictures of simple objects for tests of `relief`, and measures of what it makes."""

import numpy as np
from PIL import Image

from phy124.camera import Camera
from phy124.generators.relief import VIEW_DISTANCE

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


def shaded(mask, normal_x):
    """Lit from the front: darker where the surface turns away."""
    light = np.sqrt(np.clip(1 - normal_x**2, 0, 1))[..., None] * [200, 120, 60]
    return picture(mask, (60 + 0.7 * light).astype(np.uint8))


def extents(gaussians, low, high):
    """Depth and width of what lies between two heights."""
    part = gaussians.means[(gaussians.means[:, 2] > low) & (gaussians.means[:, 2] < high)]
    return np.ptp(part[:, 0]), np.ptp(part[:, 1])


def outlines(renderer, gaussians, inputs, elevation=0.0):
    """Return the object's mask in a picture [H,W], and in the front camera's rendering of the same
    size. The camera may be raised by an elevation in degrees."""
    wanted = np.asarray(inputs)[..., 3] > 127
    rows, columns = np.nonzero(wanted)
    longest = max(np.ptp(rows), np.ptp(columns)) + 1
    fov = np.degrees(2 * np.arctan(SIZE / 2 / (longest * VIEW_DISTANCE)))
    shift = tuple((middle.min() + middle.max() + 1 - SIZE) / 2 for middle in (columns, rows))
    up = np.radians(elevation)
    eye = VIEW_DISTANCE * np.cos(up), 0, VIEW_DISTANCE * np.sin(up)
    camera = Camera(eye, (0, 0, 0), SIZE, SIZE, float(fov), shift)
    return wanted, renderer(gaussians, camera, (0, 0, 0), alpha=True)[..., 3] > 0.5
