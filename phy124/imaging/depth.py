"""Estimates the depth of an object's front with trained networks: MoGe-2 and Depth Anything V2.

Wang et al. 2025, "MoGe-2: Accurate Monocular Geometry with Metric Scale and Sharp Details"; Yang et
al. 2024, "Depth Anything V2". The scale and the offset of the depth are arbitrary, because `relief`
sets both.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.imaging.image import normalise, reduce_size
from phy124.runtime import isolated
from phy124.weights.onnx import OnnxNetwork
from phy124.weights.store import is_complete, require

Map = NDArray[np.float32]
MARGIN = 0.25
"""Width of the surroundings that a network sees, relative to the object's longest side."""
PATCH = 14
SIDE = 518
"""Shortest side of a network's input [pixels]: 37 patches."""
LONGEST = 2 * SIDE
"""Longest side of a network's input [pixels]."""
TOKENS = 1800
"""Number of patches of MoGe-2; its authors suggest 1200 to 3600."""
DETAIL = 256
TRUST = 0.02
"""Weight of the depth that a network estimates, relative to the slopes that follow from its
normals.

Features larger than 1/sqrt(TRUST) pixels follow the depth, and smaller features follow the normals.
"""
STEEPEST = 4.0
"""Steeper slopes are reduced to this slope."""


def depth_anything(rgb: NDArray[np.uint8], solid: NDArray[np.bool_], path: Path) -> Map:
    """Estimate the depth [H,W] with Depth Anything V2; larger values are nearer."""
    (depth,) = OnnxNetwork(path, ["pixel_values"], ["predicted_depth"])(prepare_patches(rgb))
    # As in the original program, the centres of the corner pixels are aligned.
    rows, columns = (
        np.linspace(0, known - 1, wanted, dtype=np.float32)
        for known, wanted in zip(depth[0].shape, rgb.shape[:2], strict=True)
    )
    x, y = np.meshgrid(columns, rows)
    return np.asarray(cv2.remap(depth[0], x, y, cv2.INTER_LINEAR), np.float32)


def prepare_patches(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Resize an image [H,W,3] to whole patches and normalise it; return [1,3,h,w].

    The shortest side becomes `SIDE`, as in the original program, unless the longest side would
    exceed `LONGEST`.
    """
    height, width = rgb.shape[:2]
    scale = min(SIDE / min(height, width), LONGEST / max(height, width))
    size = whole_patches(scale * width), whole_patches(scale * height)
    image = cv2.resize(rgb / 255.0, size, interpolation=cv2.INTER_CUBIC)
    return normalise(image)


def whole_patches(length: float) -> int:
    """Round a length [pixels] to a multiple of `PATCH`, but not to zero."""
    return max(PATCH, round(length / PATCH) * PATCH)


def moge2(rgb: NDArray[np.uint8], solid: NDArray[np.bool_], path: Path) -> Map:
    """Estimate the depth [H,W] of the masked object with MoGe-2; larger values are nearer."""
    height, width = rgb.shape[:2]
    size = reduce_size(rgb.shape, LONGEST, PATCH)
    small = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.float32) / 255
    image = np.ascontiguousarray(small.transpose(2, 0, 1)[None])
    network = OnnxNetwork(path, ["image", "num_tokens"], ["points", "normal"])
    points, normals = network(image, np.array(TOKENS, np.int64))
    inside = cv2.resize(solid.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    depth = add_detail(points[0], normals[0], inside)
    full = cv2.resize(depth, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(full, np.float32)


def add_detail(points: Map, normals: Map, inside: NDArray[np.bool_]) -> Map:
    """Combine points [H,W,3] and normals [H,W,3] into a depth map [H,W]; larger values are nearer.

    The depth z minimises |grad z - slopes of the normals|^2 + TRUST |z - depth of the points|^2
    within the object (screened Poisson equation; Nehab et al. 2005). Axes are x right, y down, z
    away from the camera, and normals face the camera.
    """
    height, width = inside.shape
    size = reduce_size(inside.shape, DETAIL, 2)
    points = np.asarray(cv2.resize(points, size, interpolation=cv2.INTER_AREA), np.float32)
    normals = np.asarray(cv2.resize(normals, size, interpolation=cv2.INTER_AREA), np.float32)
    mask = cv2.resize(inside.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    depth = points[..., 2].astype(np.float64)
    if mask.sum() > 1:
        depth = np.where(mask, _fuse(depth, _slopes(points, normals, mask), mask), depth)
    full = cv2.resize(-depth.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(full, np.float32)


def _slopes(points: Map, normals: Map, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the change of z per pixel to the right and down [2,H,W]."""
    both = mask[:, 1:] & mask[:, :-1]
    steps = np.diff(points[..., 0], axis=1)[both]
    pitch = float(np.median(np.abs(steps))) if steps.size else 0.0
    towards = np.minimum(normals[..., 2], -1e-3).astype(np.float64)
    slopes = np.stack([-normals[..., 0] / towards, -normals[..., 1] / towards])
    return pitch * np.clip(slopes, -STEEPEST, STEEPEST)


def _fuse(
    depth: NDArray[np.float64], slopes: NDArray[np.float64], mask: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Solve the screened Poisson equation of `add_detail`."""
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(int(mask.sum()))
    rows, columns, values, right = [], [], [], []
    count = 0
    for axis, slope in ((1, slopes[0]), (0, slopes[1])):
        first, last = ((slice(None),) * axis + (s,) for s in (slice(None, -1), slice(1, None)))
        linked = mask[first] & mask[last]
        here, there = number[first][linked], number[last][linked]
        equation = count + np.arange(len(here))
        count += len(here)
        rows += [equation, equation]
        columns += [there, here]
        values += [np.ones(len(here)), -np.ones(len(here))]
        right.append((0.5 * (slope[first] + slope[last]))[linked])
    links = scipy.sparse.csr_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
        shape=(count, int(mask.sum())),
    )
    matrix = links.T @ links + TRUST * scipy.sparse.eye_array(links.shape[1])
    known = links.T @ np.concatenate(right) + TRUST * depth[mask]
    fused = depth.copy()
    fused[mask] = scipy.sparse.linalg.spsolve(matrix.tocsc(), known)
    return fused


@dataclass(frozen=True)
class DepthNetwork:
    """Estimates the depth of the object's front with a trained network."""

    name: str
    """Name in `NETWORKS`, and name of the weights."""
    optional: bool = False
    """Whether "auto" chose the network; another input may then replace the network."""

    def __call__(self, image_rgba: NDArray[np.uint8]) -> Map:
        """Return the depth [H,W] of an image [H,W,4]; larger values are nearer.

        Raises:
            InputError: The weights or onnxruntime are missing, or the file is of another network.
        """
        (path,) = require(self.name).values()
        rgb, solid = image_rgba[..., :3], image_rgba[..., 3] > 127
        top, left, bottom, right = _surroundings(solid)
        part = (slice(top, bottom), slice(left, right))
        seen = np.ascontiguousarray(rgb[part])
        made = isolated.run(NETWORKS[self.name], seen, solid[part], path)
        depth = np.zeros(solid.shape, np.float32)
        depth[part] = made
        # `relief` refuses a map in which the surroundings are nearer than the object.
        return np.where(solid, depth, depth[solid].min())


def _surroundings(solid: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return top, left, bottom and right [pixels]."""
    rows, columns = np.nonzero(solid.any(axis=1))[0], np.nonzero(solid.any(axis=0))[0]
    height, width = solid.shape
    if not len(rows):
        return 0, 0, height, width
    margin = round(MARGIN * max(np.ptp(rows), np.ptp(columns)))
    return (
        max(0, int(rows[0]) - margin),
        max(0, int(columns[0]) - margin),
        min(height, int(rows[-1]) + 1 + margin),
        min(width, int(columns[-1]) + 1 + margin),
    )


Estimate = Callable[[NDArray[np.uint8], NDArray[np.bool_], Path], Map]
NETWORKS: dict[str, Estimate] = {"moge2": moge2, "depth-anything": depth_anything}
"""Networks by name; earlier networks are preferred."""


def choose_network() -> DepthNetwork | None:
    """Return the first installed network, or None."""
    if find_spec("onnxruntime") is None:
        return None
    return next((DepthNetwork(n, optional=True) for n in NETWORKS if is_complete(n)), None)
