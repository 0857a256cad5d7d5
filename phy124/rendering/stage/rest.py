"""Positions of a clip's objects at rest, from which some boundaries compute their own shape."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.io.clip import Clip

Points = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AtRest:
    """The objects of a clip at rest; boundaries read them as they read a solver's `Model`."""

    points: Points
    """Finite positions of all objects, without surroundings [N,3], m."""
    bodies: Mapping[str, Points]
    """Positions of each object that has particles [Q,3], m, by name."""
    free: Points
    """Positions of the freely moving rigid solids [K,3], m."""

    @classmethod
    def of(cls, clip: Clip) -> AtRest:
        """Return the objects of a clip in its first frame."""
        means = np.asarray(clip.means[0])
        known = clip.object_mask & np.isfinite(np.asfortranarray(means)).all(axis=1)
        points, bodies, free = _columns(means[known]), {}, []
        if clip.object_id is not None:
            number, items = clip.object_id[known], [{}, *clip.scene.get("objects", [])]
            for index, (name, item) in enumerate(zip(clip.objects, items, strict=False)):
                part, motion = _columns(points[number == index]), item.get("motion")
                if motion and motion["kind"] == "free":
                    free.append(part)
                elif len(part) and not motion and not item.get("static"):
                    bodies[name] = part
        return cls(points, bodies or {"": points}, np.concatenate([points[:0], *free]))

    @property
    def rest(self) -> Points:
        """Positions of all objects that have particles [P,3], m."""
        return np.concatenate(list(self.bodies.values()))

    def rest_of(self, name: str | None) -> Points:
        """Return the positions of an object [Q,3], m; None: of all objects with particles."""
        return self.rest if name is None else self.bodies.get(name, self.rest)

    def targets_of(self, name: str | None) -> Points:
        """Return the positions of everything that a boundary acts on [Q,3], m.

        `name` is the boundary's `object`; None: all objects with particles, and all free solids.
        """
        return np.concatenate([self.rest, self.free]) if name is None else self.rest_of(name)

    def top_of(self, name: str | None) -> float:
        """Return the height of an object's top [m]; None: of all bodies and free solids."""
        return float(self.targets_of(name)[:, 2].max())


def _columns(points: NDArray) -> Points:
    """Return points in column-major order, which makes minimum and maximum several times faster."""
    return np.asfortranarray(points, np.float64)
