"""A small sweep over two files of Gaussians."""

from pathlib import Path

from phy124.io.ply import write_ply
from phy124.studies.sweep import Sweep
from support.shapes import ball


def write_balls(folder: Path) -> Path:
    """Write two files of Gaussians."""
    for name, count in (("a", 60), ("b", 80)):
        write_ply(folder / f"{name}.ply", ball(count))
    return folder


def declared(balls: Path, **changes) -> Sweep:
    data = {
        "pictures": str(balls / "*.ply"),
        "scene": "drop",
        "set": {
            "accuracy.cells": 8,
            "binding": "lattice",
            "time.frames": 3,
            "material.E": {"first": 1e4, "last": 1e6, "count": 3, "spacing": "log"},
        },
    }
    return Sweep.from_data({**data, **changes})
