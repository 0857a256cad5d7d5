"""Builds the shell of an object of boards, such as a chair; only the part inside the silhouette is
kept.

A board is a convex solid. The view rays along the outline cut the boards, so that holes in a
backrest follow the image.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.colours import Shown, clean_picture
from phy124.generators.relief.elevation import Raised
from phy124.generators.relief.shell import DRAWN_IN, Shell
from phy124.generators.shapes import choose_triangles

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
BURIED = 1.0
"""Largest depth of a point inside another board [pixels]; deeper points are left out."""
FACING = 0.2
"""Smallest cosine between the normal and the view ray at which a point gets the image's colour."""

EDGE = 1.5
"""Blur of the silhouette, for the normals of the outline [pixels]."""
MIXED = 12
"""Number of visible points whose colours are averaged for a hidden point."""


@dataclass(frozen=True, eq=False)
class Board:
    """The convex hull of corners, in upright coordinates relative to the image's centre."""

    corners: Field
    """Corners [C,3], pixels."""
    kind: str
    """Boards of the same kind have the same colours."""
    axes: Field
    """Two horizontal axes of the board, and the direction down [3,3]."""

    @cached_property
    def hull(self) -> scipy.spatial.ConvexHull:
        """Triangles and planes of the surface."""
        return scipy.spatial.ConvexHull(self.corners)

    @property
    def triangles(self) -> Field:
        """Corners of the surface's triangles [T,3,3]."""
        return self.corners[self.hull.simplices]

    def outside(self, points: Field) -> Field:
        """Return the distances of points [N,3] from the board [N], negative inside."""
        planes = self.hull.equations
        return (points @ planes[:, :3].T + planes[:, 3]).max(axis=1)

    def intersect(self, eye: Field, rays: Field) -> tuple[Field, Field]:
        """Return the distances at which rays [N,3] from the eye enter and leave the board [N], in
        units of the rays' lengths.

        If a ray misses the board, the first value is larger than the second.
        """
        planes = self.hull.equations
        speed, gap = rays @ planes[:, :3].T, -(eye @ planes[:, :3].T + planes[:, 3])
        cross = gap / np.where(np.abs(speed) < 1e-9, 1e-9, speed)
        enter = np.where(speed < 0, cross, -np.inf).max(axis=1)
        return enter, np.where(speed > 0, cross, np.inf).min(axis=1)

    def fold(self, points: Field) -> Field:
        """Return positions [N,3] relative to the board's axis; points that are mirror images get
        the same position.

        Left and right are mirror images, and so are front and back. In flat boards, above and below
        are also mirror images.
        """
        local, corners = points @ self.axes.T, self.corners @ self.axes.T
        low, high = np.sort(corners[:, 2].round(3))[[0, -1]]
        ends = [corners[np.abs(corners[:, 2] - level) < 0.01].mean(axis=0) for level in (low, high)]
        part = (local[:, 2:] - low) / (high - low)
        local -= (1 - part) * ends[0] + part * ends[1] - [0, 0, (low + high) / 2]
        flat = high - low < np.ptp(corners[:, :2], axis=0).min()
        return np.abs(local) if flat else np.column_stack([np.abs(local[:, :2]), local[:, 2]])


def board_shell(
    boards: Sequence[Board],
    rgba: Field,
    middle: Field,
    camera: Raised,
    count: int,
    rng: np.random.Generator,
) -> Shell:
    """Return the shell of the boards inside the silhouette.

    Hidden points get the colours of visible points on boards of the same kind.

    Args:
        boards: The boards.
        rgba: The image [H,W,4].
        middle: Column and row of the image's centre [2].
        camera: The camera.
        count: Approximate number of points.
        rng: Random number generator.
    """
    triangles = np.concatenate([board.triangles for board in boards])
    owner = np.repeat(np.arange(len(boards)), [len(board.triangles) for board in boards])
    planes = np.concatenate([board.hull.equations[:, :3] for board in boards])
    chosen, weights = choose_triangles(triangles, count, int(rng.integers(2**31)))
    points = np.einsum("nc,nci->ni", weights, triangles[chosen])
    sides = triangles[:, 1:] - triangles[:, :1]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2
    pitch = float(np.sqrt(area / count))
    inner = points - DRAWN_IN * planes[chosen]
    column, row = np.rint(camera.pixels(points) + middle).astype(int).T
    solid = rgba[..., 3] > 0.5
    height, width = solid.shape
    kept = solid[row.clip(0, height - 1), column.clip(0, width - 1)]
    rays, turned = _edge_rays(solid, middle, camera, max(1, round(pitch)))
    walls = [_cut_walls(board, rays, turned, camera, pitch) for board in boards]
    points = np.concatenate([inner[kept], *(wall[0] for wall in walls)])
    normals = np.concatenate([planes[chosen][kept], *(wall[1] for wall in walls)])
    numbers = [np.full(len(wall[0]), k) for k, wall in enumerate(walls)]
    owner = np.concatenate([owner[chosen][kept], *numbers])
    bare = np.ones(len(points), bool)
    for k, board in enumerate(boards):
        bare &= (owner == k) | (board.outside(points) > -BURIED - DRAWN_IN)
    points, normals, owner = points[bare], normals[bare], owner[bare]
    rgb = _colours(boards, points, normals, owner, rgba, middle, camera)
    return Shell(points, normals, np.full(len(points), pitch), rgb)


def _edge_rays(solid: Mask, middle: Field, camera: Raised, step: int) -> tuple[Field, Field]:
    """Return the view rays [N,3] along the outline, and the outward normals [N,3] of the surfaces
    that the rays cut. The depth of each ray is the camera's distance.
    """
    outlines, _ = cv2.findContours(solid.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    pixels = np.concatenate([line[::step, 0] for line in outlines])
    slopes = np.gradient(scipy.ndimage.gaussian_filter(solid.astype(np.float64), EDGE))
    out = -np.stack([slope[pixels[:, 1], pixels[:, 0]] for slope in slopes[::-1]], axis=1)
    out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
    seen = pixels + (0.5 - DRAWN_IN) * out - middle
    rays = np.column_stack([seen, np.full(len(seen), -camera.distance)])
    normals = np.column_stack([out, (seen * out).sum(axis=1) / camera.distance])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return rays @ camera.turn, normals @ camera.turn


def _cut_walls(
    board: Board, rays: Field, normals: Field, camera: Raised, pitch: float
) -> tuple[Field, Field]:
    """Return points and normals [M,3] of the faces along which rays [N,3] cut a board."""
    eye = camera.distance * camera.turn[2]
    enter, leave = board.intersect(eye, rays)
    numbers = np.ceil((leave - enter) * camera.distance / pitch).clip(0).astype(int)
    ray = np.repeat(np.arange(len(rays)), numbers)
    place = np.arange(len(ray)) - np.repeat(np.cumsum(numbers) - numbers, numbers) + 0.5
    part = enter[ray] + place / numbers[ray] * (leave - enter)[ray]
    return eye + part[:, None] * rays[ray], normals[ray]


def _colours(
    boards: Sequence[Board],
    points: Field,
    normals: Field,
    owner: NDArray[np.int_],
    rgba: Field,
    middle: Field,
    camera: Raised,
) -> Field:
    shown = Shown(
        clean_picture(rgba), (middle[0], middle[1]), np.array([0.0, 0, 1]), np.array([1.0, 0, 0])
    )
    turned = points @ camera.turn.T
    rays = camera.distance * camera.turn[2] - points
    facing = (rays * normals).sum(axis=1) > FACING * np.linalg.norm(rays, axis=1)
    seen = facing & shown.sees(turned, camera.distance)
    rgb = shown.colours(turned, camera.distance)
    for kind in {board.kind for board in boards}:
        same = [k for k, board in enumerate(boards) if board.kind == kind]
        numbers = [np.flatnonzero(owner == k) for k in same]
        places = np.concatenate(
            [boards[k].fold(points[number]) for k, number in zip(same, numbers, strict=True)]
        )
        number = np.concatenate(numbers)
        known = seen[number]
        if known.any():
            tree = scipy.spatial.KDTree(places[known])
            near = np.asarray(tree.query(places[~known], np.arange(1, MIXED + 1))[1])
            near = near.clip(0, np.count_nonzero(known) - 1)
            rgb[number[~known]] = rgb[number[known]][near].mean(axis=1)
    return rgb
