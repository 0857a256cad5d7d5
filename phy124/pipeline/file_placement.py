"""Finds the map from the coordinates of an object's file to those of a clip's first frame."""

from typing import Any

import numpy as np

from phy124.io.axes import euler
from phy124.particles import clean
from phy124.simulation import Setup
from phy124.simulation.placing import mask_object


def find_file_placement(setup: Setup, read: dict[str, Any]) -> dict[str, Any]:
    """Return `rotation` [3,3], `scale` and `shift` [3], m, of the first object.

    A position y in the file becomes `scale * rotation @ y + shift`.

    Args:
        setup: The setup of the run.
        read: Rotation, scale and shift between the file and the Gaussians of the setup.
    """
    before, after = clean(setup.source.of_object(0))[0], setup.gaussians.of_object(0)
    chosen = mask_object(setup.cleaned_scene, len(after))
    x, y = (body.means[chosen].astype(np.float64) for body in (before, after))
    turn, centre, there = euler(setup.scene.object.turn), x.mean(axis=0), y.mean(axis=0)
    scale = float(np.linalg.norm(y - there) / (np.linalg.norm(x - centre) or 1.0))
    return {
        "rotation": (turn @ read["rotation"]).tolist(),
        "scale": scale * read["scale"],
        "shift": (there + scale * turn @ (read["shift"] - centre)).tolist(),
    }
