"""Encode a live run for the browser: Gaussians and their binding first, then the motion per frame.

The Gaussians are bound to selected particles, the nodes. The binding contains the constant data of
each Gaussian, and is sent first. A frame contains the current data of each node and the positions
of the walls. Binding and frame are little-endian and planar (array after array):

    binding  position at rest [N,3] float32, covariance at rest [N,6] float32 (xx xy xz yy yz zz),
             largest stretch [N] float32, nodes at rest [P,3] float32, nodes of each Gaussian [N,8]
             uint16, their weights [N,8] uint8, colour and opacity [N,4] uint8
    frame    box of the nodes [2,3] float32, positions in it [P,3] uint16, F [P,9] int16

The encoded walls follow (`Walls`). A node takes 24 bytes per frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians
from phy124.live import Live
from phy124.motion.binding import find_carriers
from phy124.rendering.stage.rest import AtRest
from phy124.rendering.stage.solids import floor_heights, place_walls

MOST = 5000
"""Largest number of nodes. Sending the data of all nodes takes 2.9 MB/s at 24 frames per second."""
REACH = 8.0
"""Largest magnitude of an entry of the deformation gradient F. Larger entries are clipped."""


class Lattice:
    """The nodes (selected particles) to which the visible Gaussians of a live run are bound."""

    def __init__(self, live: Live, most: int = MOST) -> None:
        """Bind each Gaussian to its nearest nodes; `most` is the largest number of nodes."""
        look, rest = live.look, live.rest
        # In random order, the first Gaussians are an unbiased sample of all Gaussians.
        order = np.random.default_rng(0).permutation(len(look.gaussians))
        self.gaussians, moves = look.gaussians.select(order), look.moves[order]
        stretch = np.ones(len(order), np.float32)
        stretch[look.moves] = np.minimum(look.max_stretch, look.holds)
        self._stretch = np.minimum(stretch[order], 1e6)
        self.nodes, near, self.weights = _bound(self.gaussians, rest, most)
        self.neighbours = near.astype("<u2")
        # Gaussians that do not move are not bound to nodes.
        self.weights[~moves] = 0
        self.rest = rest[self.nodes]
        self._live = live

    def binding(self) -> bytes:
        """Encode the data that stay constant in a live run: Gaussians at rest, and their nodes."""
        g = self.gaussians
        sigma = g.covariances()[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
        floats = [g.means, sigma, self._stretch, self.rest]
        colours = np.rint(np.column_stack([g.rgb, g.opacities]) * 255).clip(0, 255)
        whole = np.rint(self.weights * 255).astype(np.uint8)
        parts = [*(part.astype("<f4") for part in floats), self.neighbours, whole]
        return b"".join(part.tobytes() for part in [*parts, colours.astype(np.uint8)])

    def frame(self) -> bytes:
        """Encode the positions and deformation gradients of the nodes."""
        x, F = (values[self.nodes] for values in self._live.particles)
        low, high = x.min(axis=0), x.max(axis=0)
        steps = np.rint((x - low) / np.maximum(high - low, 1e-12) * 65535).astype("<u2")
        turned = np.rint(F.reshape(-1, 9).clip(-REACH, REACH) * (32767 / REACH)).astype("<i2")
        box = np.stack([low, high]).astype("<f4")
        return b"".join(part.tobytes() for part in (box, steps, turned))


def _bound(
    gaussians: Gaussians, rest: NDArray, most: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float32]]:
    """Return at most `most` particles as nodes, and each Gaussian's nodes and weights [N,8]."""
    nodes = np.arange(len(rest))
    near, weights = find_carriers(gaussians.means, rest)
    used = np.unique(near)
    if len(used) > most:
        nodes = np.sort(np.random.default_rng(0).permutation(used)[:most])
        near, weights = find_carriers(gaussians.means, rest[nodes])
        used = np.unique(near)
    return nodes[used], np.searchsorted(used, near), weights


class Walls:
    """The floor of a live run and its other boundaries, as solids that move without rotation.

    A frame contains the height of the floor and the displacement of each solid, as float32; NaN if
    there is no floor or the solid is absent.
    """

    def __init__(self, live: Live) -> None:
        self._live = live
        rest = AtRest(live.rest, live.bodies, live.rest[:0])
        walls = place_walls(live.scene.boundaries, rest)
        self._floors = [wall for wall in walls if wall.is_floor]
        self._others = [wall for wall in walls if not wall.is_floor]

    @property
    def floor(self) -> float | None:
        """Current height of the floor [m]; None if there is no floor."""
        if not self._floors:
            return None
        return float(floor_heights(self._floors, self._live.rest, np.array([self._live.time]))[0])

    def data(self) -> list[dict[str, Any]]:
        """Return the solids in their initial position, as plain data."""
        solids = [wall.solid() for wall in self._others]
        return [
            {
                "centre": solid.centre.tolist(),
                "axes": solid.axes.tolist(),
                "half": solid.half.tolist(),
                "radius": solid.radius,
            }
            for solid in solids
        ]

    def frame(self) -> bytes:
        """Encode the current positions of the floor and of the solids."""
        now = np.array([self._live.time])
        moved = [
            wall.displacements(now)[0] if wall.present(now)[0] else np.full(3, np.nan)
            for wall in self._others
        ]
        floor = np.nan if self.floor is None else self.floor
        return np.array([floor, *np.ravel(moved)], "<f4").tobytes()
